"""Several lookups of a texture blended at a point of the ground, as contrasty as each of them.

The deviations of a mean of K independent values are smaller than theirs by the root of the sum of
the squared weights (Heitz and Neyret, "High-performance by-example noise using a
histogram-preserving blending operator", 2018).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def mean_of_lookups(parts: Sequence[Floats], weights: Floats) -> Floats:
    """Return the mean of K arrays (..., C) with (K, ...) weights, which sum to 1."""
    total = parts[0] * weights[0, ..., None]
    for part, weight in zip(parts[1:], weights[1:], strict=True):
        total += part * weight[..., None]
    return total


def contrast_gain(weights: Floats) -> Floats:
    """Return (..., 1) factors for deviations from the texture's mean, by (K, ...) weights."""
    return np.asarray(1 / np.sqrt((weights * weights).sum(axis=0))[..., None])


def restore_contrast(texel: Floats, gain: Floats, mean: Floats) -> None:
    """Give blended (..., 3 or more) texels, in place, the contrast of single ones.

    Args:
        texel: Linear colours, and what else the texture holds, which stays.
        gain: See `contrast_gain`.
        mean: (3,) mean colour of the texture.
    """
    texel[..., :3] = np.maximum(mean + gain * (texel[..., :3] - mean), 0)
