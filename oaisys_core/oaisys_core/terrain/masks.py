"""Where each layer of the ground's material lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import fractal, grid, warped


def blend_masks(
    n_layers: int,
    extent_m: float,
    size_px: int,
    rng: np.random.Generator,
    scale_m: float,
    sharpness: float,
) -> NDArray[np.float32]:
    """Return (n_layers, size_px, size_px) float32 weights that sum to 1.

    Patches are about ``scale_m`` wide with ragged borders; each layer has a fair share of the
    ground. ``sharpness`` 0 gives wide transitions, 1 hard borders.
    """
    if n_layers == 1:
        return np.ones((1, size_px, size_px), np.float32)
    x, y = grid(extent_m, size_px, cell=scale_m)
    x, y = warped(x, y, rng, strength=0.5, octaves=5)
    scores = np.stack([_ranked(fractal(x, y, rng, octaves=6)) for _ in range(n_layers)])
    temperature = 0.4 * (1 - sharpness) ** 2 + 1e-3
    logits = scores / np.float32(temperature)
    logits -= logits.max(axis=0)
    weights = np.exp(logits)
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def _ranked(field: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the field centred and scaled so that no layer covers much more than another."""
    return np.asarray((field - np.median(field)) / (field.std() + 1e-9), np.float32)
