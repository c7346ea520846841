"""Borders between layers of the ground that follow the relief of their textures.

At each point, a layer's weight in the masks and the height of its texture there decide together
which layer is seen: sand fills the gaps between stones, and the highest stones stick out of it far
inside the sand. Labels do not change: the layer of the largest weight has them.

Heights are Gumbel values, -ln(-ln u) of a texel whose rank among those of its tile is u, from 0
(lowest) to 1 (highest). The layer with the largest sum of height and ln(weight) is seen. So each
layer covers, whatever their number, the share of the ground that its mask says (the Gumbel-max
trick: Maddison, Tarlow and Minka, "A* Sampling", NeurIPS 2014, section 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.terrain_material import PbrMaps
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]
Floats = NDArray[np.floating[Any]]
N = TypeVar("N", float, FloatArray)
"""A number, or an array of them."""

MIN_HEIGHT, MAX_HEIGHT = -2.0, 6.0
"""Bounds of heights; a quarter of a percent of all texels would be higher, fewer are lower."""

MEAN_HEIGHT = 0.5772
"""Mean of Gumbel values: Euler's constant."""

HEIGHT_VARIANCE = 1.61
"""Of Gumbel values within these bounds; pi^2 / 6 without."""

WIDTH = 0.24
"""Width of a border between two reliefs that are seen in full: scale of a logistic function."""

CRISPNESS = 0.3
"""Share by which such a border is steeper than that function, which has no end."""

HEIGHT_BINS = 2048

NEGLIGIBLE = 1.5 / 255
"""Weights below it count as 0, and above 1 minus it as 1."""

MIN_WEIGHT = 1e-8
"""Instead of a negligible weight, whose logarithm is taken."""


class Heights(NamedTuple):
    """Heights of one level of a texture set.

    Attributes:
        texels: (N, N) uint8, 0 for `MIN_HEIGHT` and 255 for `MAX_HEIGHT`.
        variance: Of the heights.
    """

    texels: NDArray[np.uint8]
    variance: float


def height_levels(levels: Sequence[PbrMaps]) -> list[Heights]:
    """Return the heights of each level of a texture set."""
    found = [gumbel_heights(levels[0].height)]
    for maps in levels[1:]:
        size = maps.height.shape[::-1]
        found.append(np.asarray(cv2.resize(found[-1], size, interpolation=cv2.INTER_AREA)))
    scale = np.float32(255 / (MAX_HEIGHT - MIN_HEIGHT))
    return [
        Heights(
            np.rint((each - np.float32(MIN_HEIGHT)) * scale).astype(np.uint8), float(each.var())
        )
        for each in found
    ]


def gumbel_heights(height: NDArray[np.float32]) -> Image:
    """Return (N, N) heights by the ranks of those given; their mean if all are the same."""
    low, high = float(height.min()), float(height.max())
    if high <= low:
        return np.full(height.shape, MEAN_HEIGHT, np.float32)
    scale = np.float32((HEIGHT_BINS - 1) / (high - low))
    bins = ((height - np.float32(low)) * scale).astype(np.intp)
    counts = np.bincount(bins.ravel(), minlength=HEIGHT_BINS)
    rank = (np.cumsum(counts) - counts / 2) / height.size
    # Bins that nothing is in have ranks of 0 and 1 at the ends.
    values = -np.log(-np.log(np.clip(rank, 1e-9, 1 - 1e-9)))
    values = np.clip(values, MIN_HEIGHT, MAX_HEIGHT).astype(np.float32)
    return np.asarray(values[bins])


class LayerBorder(NamedTuple):
    """How a layer turns into those before it, by the difference of their keys.

    The mix factor is tanh(slope * difference) * gain + 1 / 2, clamped to [0, 1]. It is 0 at a
    negligible weight, and 1 if that of the others is negligible, whatever the heights.

    Attributes:
        slope, gain: As above.
        surplus: Times factor * (1 - factor), what the key of both is above the mean of their keys
            by the factor: their log-sum-exp, at this border's width.
    """

    slope: Floats | float
    gain: Floats | float
    surplus: Floats | float


def borders(variances: Sequence[N]) -> list[LayerBorder]:
    """Return the border of each layer but the first with those before it.

    Variance of heights that a coarse level has lost is in the border's width, so that borders are
    seen from afar as the masks are: without relief, the mix factor is the layer's weight.

    Args:
        variances: Of the heights of each layer at a level: numbers, or arrays of points.
    """
    lost = [1 - np.minimum(variance / HEIGHT_VARIANCE, 1) for variance in variances]
    result = []
    for layer in range(1, len(lost)):
        unseen = (lost[layer] + sum(lost[:layer]) / layer) / 2
        width = np.sqrt(WIDTH**2 + unseen)
        gain = (1 + CRISPNESS * (1 - unseen)) / (2 - 4 * NEGLIGIBLE)
        result.append(LayerBorder(1 / (2 * width), gain, 4 * log(2) * width))
    return result


def keys(heights: Image, weights: Image) -> Image:
    """Return the keys of a layer's points, of which the largest is seen."""
    least = np.float32(MIN_WEIGHT)
    return np.asarray(heights + np.log(np.maximum(weights - np.float32(NEGLIGIBLE), least)))


def mix(key: Image, below: Image, border: LayerBorder) -> tuple[Image, Image]:
    """Return the mix factor of a layer over those before it, and the key of all of them."""
    above = key - below
    slope, gain, surplus = (np.asarray(each, np.float32) for each in border)
    factor = np.clip(np.tanh(above * slope) * gain + np.float32(0.5), 0, 1)
    return factor, below + factor * (above + (1 - factor) * surplus)


def relief_weights(weights: FloatArray, heights: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the (N, L) weights with which layers are seen at N points.

    Args:
        weights: (N, L) weights by the masks.
        heights: (N, L) heights of each layer there.
        variances: (N, L) variances of the heights of the levels that ``heights`` are of.
    """
    of_layers = keys(heights.astype(np.float32), weights.astype(np.float32)).T
    seen = np.zeros_like(weights)
    seen[:, 0], below = 1.0, of_layers[0]
    for layer, border in enumerate(borders(list(variances.T)), start=1):
        factor, below = mix(of_layers[layer], below, border)
        seen[:, :layer] *= 1 - factor[:, None]
        seen[:, layer] = factor
    return seen
