"""Where pieces of broken rock lie in steep ground: side by side, with their rims in the rock.

A wall is a few cells of a grid wide, however high it is: between its foot and its rim, a height
field has no points that could stand out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.placement.density import draw_texels
from oaisys_core.procedural.scatter.placement.random_poses import (
    power_law_sizes,
    rises_m,
)
from oaisys_core.procedural.scatter.placement.spacing import Spacing, first_come, pairs_too_near
from oaisys_core.procedural.terrain.masks.relief import relief_of
from oaisys_core.scene import Ground, TerrainMaterial
from oaisys_core.types import FloatArray

STEEP_DEG = (32.0, 42.0)
"""Slopes from which on rock is broken here and there, and everywhere."""

LEAST_WEIGHT = 0.5
"""Weight of the layer from which on its rock is bare."""

SIZES_M, EXPONENT = (1.2, 7.0), 0.8
"""Least and largest width of a piece, and the exponent of the law of widths."""

SMALLEST, LARGEST = 0.04, 0.25
"""Least and largest width of a piece, in the height of the ground, at least and at most."""

LEAST_CELLS = 3.0
"""Least width of a piece, in cells of the ground."""

TRIES, MOST_TRIES = 5.0, 12_000
"""Area of all pieces that are tried, in that of the walls, and their largest number."""

APART = 0.5
"""Least distance of two pieces, in their mean width."""

INSIDE = ((0.5, 0.3), (0.36, 0.08))
"""Distances from the middle of a piece, in its width, at which the ground has to be less deep in
the wall than this, in the same: else the edge of the piece would show."""

OUTSIDE = (0.22, 0.06)
"""Distance at which the ground may not stand out of the wall by more than this: else splinters of
the piece would show."""

SHRINKS, SHRINK = 6, 0.75
"""How often a piece that does not fit becomes smaller, and by how much."""

RING_POINTS = 16
"""Points that are looked at at each of these distances."""

MAP_PX = 512
"""Largest size of the grid on which walls are looked for."""


class _Walls(NamedTuple):
    """Steep parts of a layer.

    Attributes:
        area_m2: (M, M) area of the surface in each texel; row 0 at min_y.
        low_m: (min_x, min_y) of the first texel.
        texel_m: Size of a texel, along x and y.
    """

    area_m2: FloatArray
    low_m: FloatArray
    texel_m: FloatArray

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, 2) places, as many everywhere on the surface."""
        total = np.cumsum(self.area_m2, dtype=np.float64)
        _, _, place = draw_texels(total, self.area_m2.shape[1], count, rng)
        return np.asarray(self.low_m + place * self.texel_m)


def place_on_walls(
    layer: int, material: TerrainMaterial, ground: Ground, rng: np.random.Generator
) -> FloatArray:
    """Return the (N, 4, 4) poses, with scale, of pieces of rock on the walls of a stage.

    A piece has x along the wall, y up, and z out of it, and is 1 m wide.

    Args:
        layer: Index of the layer in the material, on whose steep parts they lie.
        material: Of the ground.
        ground: The stage.
        rng: Draws them.
    """
    walls, height_m = _find_walls(layer, material, ground)
    least_m = max(SIZES_M[0], SMALLEST * height_m, LEAST_CELLS * ground.spacing_m)
    largest_m = min(SIZES_M[1], LARGEST * height_m)
    area_m2 = float(walls.area_m2.sum())
    if not area_m2 > least_m**2 or not largest_m > least_m:
        return np.zeros((0, 4, 4))
    mean_m2 = float(np.mean(power_law_sizes(4096, (least_m, largest_m), EXPONENT, rng) ** 2))
    count = min(round(TRIES * area_m2 / mean_m2), MOST_TRIES)
    sizes_m = np.sort(power_law_sizes(count, (least_m, largest_m), EXPONENT, rng))[::-1]
    xy_m = walls.draw(count, rng)
    axes = _axes(ground, xy_m)
    middle_m = np.column_stack((xy_m, ground.height_at(xy_m)))
    sizes_m, fits = _fit(ground, middle_m, axes, sizes_m, least_m)
    order = np.flatnonzero(fits)[np.argsort(-sizes_m[fits], kind="stable")]
    pairs = pairs_too_near(middle_m[order], sizes_m[order], Spacing(APART))
    kept = order[first_come(len(order), pairs)]
    T_map_object = np.tile(np.eye(4), (len(kept), 1, 1))
    T_map_object[:, :3, :3] = axes[kept] * sizes_m[kept, None, None]
    T_map_object[:, :3, 3] = middle_m[kept]
    return T_map_object


def _find_walls(layer: int, material: TerrainMaterial, ground: Ground) -> tuple[_Walls, float]:
    """Return the steep parts of a layer, and the height of the whole ground."""
    mask = material.masks[layer]
    step = -(-len(mask) // MAP_PX)
    weight = mask[step // 2 :: step, step // 2 :: step]
    relief = relief_of(ground, len(weight))
    low, high = np.radians(STEEP_DEG)
    steep = np.clip((relief.slope_rad - low) / (high - low), 0, 1)
    x0, y0, x1, y1 = material.extent_m
    texel_m = np.array((x1 - x0, y1 - y0)) / weight.shape[::-1]
    is_bare = weight >= LEAST_WEIGHT
    area_m2 = is_bare * weight * steep / np.cos(relief.slope_rad) * texel_m.prod()
    return _Walls(area_m2, np.array((x0, y0)), texel_m), float(np.ptp(relief.height_m))


def _axes(ground: Ground, xy_m: FloatArray) -> FloatArray:
    """Return (N, 3, 3) axes of walls in columns: level and along, up, and out of the wall."""
    steepness = np.linalg.norm(_slopes(ground, xy_m, ground.spacing_m), axis=1)
    # Over a wider ground, because single triangles face to and fro.
    uphill = _slopes(ground, xy_m, LEAST_CELLS * ground.spacing_m)
    uphill /= np.maximum(np.linalg.norm(uphill, axis=1, keepdims=True), 1e-9)
    out = np.column_stack((-uphill * steepness[:, None], np.ones(len(xy_m))))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    along = np.column_stack((uphill[:, 1], -uphill[:, 0], np.zeros(len(xy_m))))
    return np.stack((along, np.cross(out, along), out), axis=-1)


def _fit(
    ground: Ground, middle_m: FloatArray, axes: FloatArray, sizes_m: FloatArray, least_m: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (N,) widths at which pieces fit to the ground around, and which have one."""
    angle = np.linspace(0, 2 * np.pi, RING_POINTS, endpoint=False)
    ring = np.column_stack((np.cos(angle), np.sin(angle), np.ones(RING_POINTS)))
    rims = np.concatenate([ring * (far, far, -deep) for far, deep in INSIDE])
    points = np.concatenate((rims, ring * (OUTSIDE[0], *OUTSIDE)))
    is_rim = np.arange(len(points)) < len(rims)
    sizes_m, fits = sizes_m.copy(), np.zeros(len(sizes_m), np.bool_)
    # A texel of a wall may hold level ground at its foot, too.
    is_steep = axes[:, 2, 2] <= np.cos(np.radians(STEEP_DEG[0]))
    left = np.flatnonzero(np.isfinite(middle_m[:, 2]) & is_steep)
    for _ in range(SHRINKS):
        points_m = np.einsum("nij,kj->nki", axes[left], points) * sizes_m[left, None, None]
        points_m += middle_m[left, None]
        ground_m = ground.height_at(points_m[..., :2].reshape(-1, 2)).reshape(points_m.shape[:2])
        fit = ((points_m[..., 2] <= ground_m) == is_rim).all(axis=1)
        fits[left[fit]] = True
        left = left[~fit]
        sizes_m[left] *= SHRINK
        left = left[sizes_m[left] >= least_m]
    return sizes_m, fits


def _slopes(ground: Ground, xy_m: FloatArray, step_m: float) -> FloatArray:
    """Return (N, 2) slopes of the ground along x and y, over twice a step; 0 at its rim."""
    return np.nan_to_num(np.column_stack(rises_m(ground, xy_m, step_m)) / (2 * step_m))
