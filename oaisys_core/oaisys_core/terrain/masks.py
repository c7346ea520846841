"""Where each layer of the ground's material lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import Field, spectral

RAGGED = 1.8
"""Fall of the noise's amplitudes with frequency; lower tears the patches' borders more."""


def blend_masks(
    n_layers: int,
    extent_m: float,
    size_px: int,
    rng: np.random.Generator,
    scale_m: float,
    sharpness: float,
) -> NDArray[np.float32]:
    """Return (n_layers, size_px, size_px) float32 weights that sum to 1.

    Patches are about ``scale_m`` wide, their borders ragged down to single texels, with islands;
    each layer has a fair share of the ground. ``sharpness`` 0 gives wide transitions, 1 hard
    borders.
    """
    if n_layers == 1:
        return np.ones((1, size_px, size_px), np.float32)
    waves = max(extent_m / (2 * scale_m), 1.0)
    scores = np.stack([_patches(size_px, waves, rng) for _ in range(n_layers)])
    temperature = 0.6 * (1 - sharpness) ** 1.5 + 1e-3
    logits = scores / np.float32(temperature)
    logits -= logits.max(axis=0)
    weights = np.exp(logits)
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def _patches(size_px: int, waves: float, rng: np.random.Generator) -> Field:
    """Return noise that is above 0 on half of the ground, so that no layer is left out."""
    field = spectral(size_px, waves, rng, RAGGED)
    return np.asarray(field - np.median(field), np.float32)
