"""Borders between layers of the ground that follow the relief of their textures.

At each point, a layer's share of the mask and the height of its texture there decide together
which layer is seen: sand fills the gaps between stones, and the highest stones stick out of it far
inside the sand. Labels do not change: the layer of the largest weight has them.

Heights are ranks, from 0 (lowest texel of a tile) to 1 (highest). As those of two layers differ by
more than d in (1 - d)^2 / 2 of all places, a layer covers, within 0.01, the share of the ground
that its mask says, if masks are rooted (`rooted`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_core.world.terrain_material import PbrMaps, TerrainMaterial
from oaisys_core.world.tiling import PlainTiling, StochasticTiling, VoronoiTiling

N = TypeVar("N", float, FloatArray)
"""A number, or an array of them."""

BLEND = 0.12
"""Half the difference in rank over which one layer turns into the other."""

RANK_VARIANCE = 1 / 12
"""Variance of ranks, which are distributed evenly."""

LOOKUPS = {PlainTiling: 1, VoronoiTiling: 2, StochasticTiling: 3}
"""Texture lookups of each kind of tiling."""

MOST_LOOKUPS = 6
"""Materials whose layers need more are blended by masks alone: each is made at every point, and
Cycles keeps its result on a stack of 255 numbers."""

RANK_BINS = 2048

NEGLIGIBLE = 1.5 / 255
"""Shares below it count as 0, and above 1 minus it as 1, so that Cycles evaluates one surface."""


def follows_relief(material: TerrainMaterial) -> bool:
    """Return whether borders of a material follow the relief of its layers."""
    lookups = sum(LOOKUPS[type(layer.tiling)] for layer in material.layers)
    return len(material.layers) > 1 and lookups <= MOST_LOOKUPS


def rooted(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the square roots of (L, R, C) weights, scaled so that they sum to 1 again.

    Negligible weights become 0, as their roots would not be negligible.
    """
    roots = np.sqrt(np.maximum(weights - np.float32(NEGLIGIBLE), 0))
    return np.asarray(roots / roots.sum(axis=0), np.float32)


def blended_masks(material: TerrainMaterial, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (L - 1, R, C) masks of all layers but the first, as they are blended.

    Args:
        material: Of which the layers are.
        weights: (L, R, C) weights of all layers, on the stage or on the land around it.
    """
    # A copy, so that the first layer's are not kept.
    return rooted(weights)[1:].copy() if follows_relief(material) else weights[1:]


class Ranks(NamedTuple):
    """Ranks of the heights of one level of a texture set.

    Attributes:
        texels: (N, N) uint8, 255 being the highest.
        variance: Of ranks from 0 to 1.
    """

    texels: NDArray[np.uint8]
    variance: float


def rank_levels(levels: Sequence[PbrMaps]) -> list[Ranks]:
    """Return the ranks of each level of a texture set."""
    found = [ranks_of(levels[0].height)]
    for maps in levels[1:]:
        size = maps.height.shape[::-1]
        found.append(np.asarray(cv2.resize(found[-1], size, interpolation=cv2.INTER_AREA)))
    return [
        Ranks(np.rint(each * np.float32(255)).astype(np.uint8), float(each.var())) for each in found
    ]


def ranks_of(height: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (N, N) rank of each height among all, 0 to 1; 0.5 if all are the same."""
    low, high = float(height.min()), float(height.max())
    if high <= low:
        return np.full(height.shape, 0.5, np.float32)
    scale = np.float32((RANK_BINS - 1) / (high - low))
    bins = ((height - np.float32(low)) * scale).astype(np.intp)
    counts = np.bincount(bins.ravel(), minlength=RANK_BINS)
    below = np.cumsum(counts) - counts / 2
    return np.asarray((below / height.size).astype(np.float32)[bins])


def blends(variances: Sequence[N]) -> list[N]:
    """Return the blend of each layer but the first with those before it.

    Variance that a coarse level has lost is in the blend, so that a border seen from afar is as
    wide as its mask's: at a blend of 1, the mix factor's slope in the middle is that of the mask.

    Args:
        variances: Of the ranks of each layer at a level: numbers, or arrays of points.
    """
    lost = [RANK_VARIANCE - variance for variance in variances]
    return [
        np.sqrt(BLEND**2 + 6 * np.maximum(lost[layer] + sum(lost[:layer]) / layer, 0.0))
        for layer in range(1, len(lost))
    ]


def factors(blend: N) -> tuple[N, N, N]:
    """Return factors of a layer's share and of its rank above those before it, and an offset.

    Their sum, clamped to [0, 1], is the layer's mix factor. It is 0 at a negligible share, and 1
    if that of the others is negligible, whatever the ranks.
    """
    of_share = (1 + blend) / (blend * (1 - 2 * NEGLIGIBLE))
    return of_share, 1 / (2 * blend), -1 / (2 * blend) - NEGLIGIBLE * of_share


def relief_weights(weights: FloatArray, ranks: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the (N, L) weights with which layers are seen at N points.

    Args:
        weights: (N, L) weights by the masks.
        ranks: (N, L) ranks of the heights of each layer there, 0 to 1.
        variances: (N, L) variances of the ranks of the levels that ``ranks`` are of.
    """
    shares = rooted(weights.T.astype(np.float32))
    seen = np.zeros_like(weights)
    seen[:, 0], below, total = 1.0, ranks[:, 0], shares[0]
    for layer, blend in enumerate(blends(list(variances.T)), start=1):
        total = total + shares[layer]
        of_share, of_rank, offset = factors(blend)
        above = ranks[:, layer] - below
        share = shares[layer] / np.maximum(total, 1e-6)
        factor = np.clip(share * of_share + above * of_rank + offset, 0.0, 1.0)
        seen[:, :layer] *= 1 - factor[:, None]
        seen[:, layer] = factor
        below = below + above * factor
    return seen
