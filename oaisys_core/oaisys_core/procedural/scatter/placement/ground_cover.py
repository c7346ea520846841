"""Where grass or stones of a layer are: as dense as the layer, sparse and small at its edge."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.placement.density import draw_texels
from oaisys_core.procedural.scatter.placement.random_poses import (
    bedding,
    leaning,
    poses_with_scale,
    slope_deg,
)
from oaisys_core.procedural.terrain.noise import Field, spectral
from oaisys_core.scene import Ground, TerrainMaterial
from oaisys_core.scene.terrain_material import MAX_TONE, MIN_TONE
from oaisys_core.types import FloatArray

MOST_PLACES = 40_000
"""Largest number of one kind on a stage; on large stages they are fewer and larger."""

LARGEST = 1.6
"""By how much they are larger at most."""

EDGE_M = 0.35
"""Standard deviation of the blur from which a patch knows how near the layer's edge is."""

LEAST_WEIGHT = 0.25
"""Weight of the layer from which on there are some."""

STUNTED = 0.5
"""Size of patches at the edge of a layer, where it covers hardly anything around them."""

CLUMP_M, CLUMPS_PX = 3.0, 256
"""Width of the places where patches are dense or large, and size of their map."""

SUNK = 0.01
"""Depth of the feet below the ground, in widths of a patch."""

SHORE_M = 0.03
"""Height above the water from which on there are some."""

TONES = 3
"""Number of colours of the patches of a layer: lush, usual and dry."""


class CoverKind(Protocol):
    """What many instances on a layer share."""

    @property
    def per_m2(self) -> float:
        """Instances where the layer covers all of the ground."""

    @property
    def width_m(self) -> tuple[float, float]:
        """(least, largest) width of one."""

    @property
    def clumping(self) -> float:
        """How much they are in clumps: 0 anywhere, 1 only in the best half of places."""

    @property
    def max_slope_deg(self) -> float:
        """Steepest ground on which they are."""


class CoverPlaces(NamedTuple):
    """Where grass or stones of one kind are.

    Attributes:
        xy_m: (N, 2) positions in ``map``.
        sizes_m: (N,) widths.
    """

    xy_m: FloatArray
    sizes_m: FloatArray


def cover_places(
    kind: CoverKind,
    layer: int,
    material: TerrainMaterial,
    ground: Ground,
    rng: np.random.Generator,
    water_m: float | None = None,
) -> CoverPlaces:
    """Return where grass or stones of a layer are on a stage.

    Args:
        kind: What they are.
        layer: Index of the layer in the material.
        material: Of the ground.
        ground: The stage.
        rng: Draws them.
        water_m: Level of the water, in which there are none.
    """
    x0, y0, x1, y1 = material.extent_m
    mask = material.masks[layer]
    texel_m = np.array((x1 - x0, y1 - y0)) / mask.shape[::-1]
    near = _blur(mask, texel_m)
    clumps = _clumps(mask.shape, float(max(x1 - x0, y1 - y0)), rng)
    wanted = near * mask * (mask >= LEAST_WEIGHT)
    wanted *= np.clip(1 + kind.clumping * (2 * clumps - 1.5), 0, 1)
    total = np.cumsum(wanted, dtype=np.float64)
    number = kind.per_m2 * float(total[-1]) * float(texel_m.prod())
    count = min(round(number), MOST_PLACES)
    if not count:
        return CoverPlaces(np.zeros((0, 2)), np.zeros(0))
    rows, columns, place = draw_texels(total, mask.shape[1], count, rng)
    xy_m = np.array((x0, y0)) + place * texel_m
    grown = STUNTED + (1 - STUNTED) * near[rows, columns]
    grown *= 0.75 + 0.5 * clumps[rows, columns]
    sizes_m = rng.uniform(*kind.width_m, count) * grown * min((number / count) ** 0.5, LARGEST)
    stands = slope_deg(ground, xy_m) <= kind.max_slope_deg
    if water_m is not None:
        stands &= ground.height_at(xy_m) > water_m + SHORE_M
    return CoverPlaces(xy_m[stands], sizes_m[stands])


def cover_poses(
    ground: Ground, xy_m: FloatArray, sizes_m: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return (N, 4, 4) poses with scale of patches of (N,) sizes at (N, 2) places on a ground."""
    from scipy.spatial.transform import Rotation

    if not len(xy_m):
        return np.zeros((0, 4, 4))
    slope, _ = bedding(ground, xy_m, np.maximum(sizes_m / 3, ground.spacing_m / 2))
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, (len(xy_m), 1)))
    # Hidden by its blades, a patch may stand hollow; sunk by the depth of a hollow, it is too low.
    base_m = ground.height_at(xy_m) - SUNK * sizes_m
    return poses_with_scale(leaning(slope) * turn, sizes_m, xy_m, base_m)


def tones_at(material: TerrainMaterial, xy_m: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return (N,) numbers of the tone of the ground at (N, 2) points, and (`TONES`, 3) factors.

    The factors are those on the linear colour of the ground, their mean where the tone is alike.
    """
    if material.tone is None or not len(xy_m):
        return np.zeros(len(xy_m), np.intp), np.ones((TONES, 3))
    pixels = material.tone.pixels
    x0, y0, x1, y1 = material.extent_m
    share = (xy_m - (x0, y0)) / (x1 - x0, y1 - y0)
    size = np.array(pixels.shape[1::-1])
    column, row = np.clip((share * size).astype(np.intp), 0, size - 1).T
    factors = MIN_TONE + pixels[row, column] * ((MAX_TONE - MIN_TONE) / 255)
    red = factors[:, 0]
    tone = np.searchsorted(np.quantile(red, np.arange(1, TONES) / TONES), red)
    means = [factors[tone == each].mean(axis=0) for each in range(TONES) if (tone == each).any()]
    _, tone = np.unique(tone, return_inverse=True)
    return tone, np.array([*means, *np.ones((TONES - len(means), 3))])


def _blur(mask: Field, texel_m: FloatArray) -> Field:
    import cv2

    sigma_x, sigma_y = (EDGE_M / texel_m).tolist()
    if max(sigma_x, sigma_y) < 0.3:
        return mask
    blurred = cv2.GaussianBlur(mask, (0, 0), sigma_x, sigmaY=sigma_y)
    return np.asarray(np.clip(blurred, 0, 1), np.float32)


def _clumps(shape: tuple[int, ...], extent_m: float, rng: np.random.Generator) -> Field:
    """Return a map from 0 to 1 of how well grass grows, half of it above 0.5."""
    import cv2

    waves = float(np.clip(extent_m / (2 * CLUMP_M), 1, CLUMPS_PX / 4))
    noise = spectral(CLUMPS_PX, waves, rng, 1.9)
    wide = cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(0.5 + 0.35 * (wide - np.median(noise)), 0, 1), np.float32)
