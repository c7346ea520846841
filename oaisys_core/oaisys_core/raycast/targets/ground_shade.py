"""Where a height field can hide anything from the sun, so that most rays need not be cast at it.

A ray that begins above a height field meets it first where the ground rises more steeply along the
ray's course than the ray does. Only rays towards the blocks of cells where it does so, from below
their tops, need to be cast.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from math import asin, ceil, cos, hypot, sin, tan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.targets.ray_target import RayCone
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

BLOCK = 8
"""Cells along the edge of a block."""

SLOPE_MARGIN, HEIGHT_MARGIN_M = 1e-3, 1e-3
"""More than vertices and rays in float32 differ from those in float64."""

MIN_ELEVATION_RAD, MAX_ELEVATION_RAD = 0.02, 1.5
"""Rays that are more level, or closer to the vertical, may be hidden anywhere."""

LATERAL_BLOCKS = 2
"""Blocks to each side of a sheared row that a ray may run through, wherever in its own block it
begins: its course is rounded to whole blocks, and so is the row's."""


class GroundShade:
    """Bounds of the heights below which a height field may hide rays."""

    def __init__(self, ground: HeightField) -> None:
        """Take over a ground; its slopes are looked at when the first rays ask."""
        self._ground = ground
        self._size_m = BLOCK * ground.spacing_m
        self._x0_m, self._y0_m = ground.origin_xy_m
        # Of smaller blocks at the end, a part lies beyond the ground.
        self._whole_rows, self._whole_columns = ((n - 1) // BLOCK for n in ground.elevation_m.shape)
        self._limits_m = lru_cache(maxsize=2)(self._find_limits_m)

    def may_hide(self, origins_m: FloatArray, cone: RayCone) -> NDArray[np.bool_]:
        """Return (R,) whether the ground may hide rays of a cone from (R, 3) origins above it.

        Rays from beside it may always be hidden.
        """
        limits_m = self._limits_m(cone)
        rows, columns = limits_m.shape
        column = _block(origins_m[:, 0], self._x0_m, self._size_m, columns)
        row = _block(origins_m[:, 1], self._y0_m, self._size_m, rows)
        return np.asarray(origins_m[:, 2] < limits_m.reshape(-1).take(row * columns + column))

    @cached_property
    def _blocks(self) -> _Blocks:
        return _blocks_of(self._ground)

    def _find_limits_m(self, cone: RayCone) -> FloatArray:
        """Return the heights below which points of each block may be hidden.

        There is one more block at each side, for all points beyond the ground.
        """
        tops_m = self._blocks.tops_m
        found_m = np.full((tops_m.shape[0] + 2, tops_m.shape[1] + 2), np.inf)
        highest_rad = cone.elevation_rad + cone.half_angle_rad
        if cone.lowest_rad > MIN_ELEVATION_RAD and highest_rad < MAX_ELEVATION_RAD:
            turn_rad = asin(sin(cone.half_angle_rad) / cos(cone.elevation_rad))
            x, y, _ = cone.axis
            level = hypot(x, y)
            towards = (x / level, y / level)
            rise = tan(cone.lowest_rad) - SLOPE_MARGIN
            steepest = self._blocks.steepest(towards, turn_rad)
            # A slope that is not a number counts as steep.
            hiding_m = np.where(steepest <= rise, -np.inf, tops_m + HEIGHT_MARGIN_M)
            rise_m = rise * self._size_m
            above_m = float(tops_m.max()) + HEIGHT_MARGIN_M - self._blocks.lowest_m
            most = max(tops_m.shape)
            reach = ceil(above_m / rise_m) + 1 if rise_m * most > above_m else most
            # The derivative of a shear by its angle is 1 + shear^2, at most 2.
            lateral = LATERAL_BLOCKS + ceil(2 * turn_rad * reach)
            swept_m = _sweep(hiding_m, towards, lateral, rise_m)
            rows, columns = self._whole_rows, self._whole_columns
            found_m[1 : rows + 1, 1 : columns + 1] = swept_m[:rows, :columns]
        return found_m


class _Blocks(NamedTuple):
    """Bounds of blocks of cells of a height field; all arrays are (rows, columns).

    Attributes:
        lowest_m: Lowest vertex of all.
        tops_m: Their highest vertices.
        low, high: The least and the greatest slopes of their triangles along x and along y.
    """

    lowest_m: float
    tops_m: FloatArray
    low: tuple[FloatArray, FloatArray]
    high: tuple[FloatArray, FloatArray]

    def steepest(self, towards: tuple[float, float], turn_rad: float) -> FloatArray:
        """Return bounds of the slopes along level unit vectors that are up to an angle apart."""
        bound = np.zeros(self.tops_m.shape)
        for along, low, high in zip(towards, self.low, self.high, strict=True):
            bound += along * (high if along > 0 else low)
            bound += turn_rad * np.maximum(np.abs(low), np.abs(high))
        return bound


def _blocks_of(ground: HeightField) -> _Blocks:
    """Return the bounds of a ground's blocks."""
    elevation_m = ground.elevation_m
    per_m = 1 / ground.spacing_m
    # Each triangle has one of its cell's two edges along x, and one of those along y.
    along_x, along_y = np.diff(elevation_m, axis=1), np.diff(elevation_m, axis=0)
    x_edges, y_edges = (along_x[:-1], along_x[1:]), (along_y[:, :-1], along_y[:, 1:])
    upper = np.maximum(elevation_m[:-1], elevation_m[1:])
    return _Blocks(
        float(elevation_m.min()),
        _reduce(np.maximum, np.maximum(upper[:, :-1], upper[:, 1:])),
        (
            per_m * _reduce(np.minimum, np.minimum(*x_edges)),
            per_m * _reduce(np.minimum, np.minimum(*y_edges)),
        ),
        (
            per_m * _reduce(np.maximum, np.maximum(*x_edges)),
            per_m * _reduce(np.maximum, np.maximum(*y_edges)),
        ),
    )


def _reduce(function: Any, of_cells: NDArray[np.float32]) -> FloatArray:
    """Return the extremes of blocks of cells; the last ones may be smaller."""
    for axis in range(2):
        of_cells = function.reduceat(of_cells, np.arange(0, of_cells.shape[axis], BLOCK), axis)
    return np.asarray(of_cells, np.float64)


def _sweep(
    hiding_m: FloatArray, towards: tuple[float, float], lateral: int, rise_m: float
) -> FloatArray:
    """Return the heights below which blocks' points may be hidden behind blocks.

    Args:
        hiding_m: (rows, columns) tops of the blocks that may hide something, ``-inf`` of others.
        towards: Level unit vector (x, y) along which rays run.
        lateral: Blocks to each side of this course that a ray may run through.
        rise_m: How much a ray rises at least on the length of a block.
    """
    along_rows = abs(towards[1]) >= abs(towards[0])
    swept_m = hiding_m if along_rows else hiding_m.T
    ahead, aside = (towards[1], towards[0]) if along_rows else towards
    if ahead < 0:
        swept_m = swept_m[::-1]
    limits_m = _sweep_ahead(swept_m, aside / abs(ahead), lateral, rise_m)
    if ahead < 0:
        limits_m = limits_m[::-1]
    return limits_m if along_rows else limits_m.T


def _sweep_ahead(hiding_m: FloatArray, shear: float, lateral: int, rise_m: float) -> FloatArray:
    """See `_sweep`, for rays that run along rows' numbers.

    ``shear`` is how many columns they pass on each row, at most 1.
    """
    from scipy.ndimage import maximum_filter1d

    rows, columns = hiding_m.shape
    if not np.isfinite(hiding_m).any():
        return np.full(hiding_m.shape, -np.inf)
    offset = np.floor(np.arange(rows) * shear).astype(np.intp)
    first = offset.max() - offset
    sheared_m = np.full((rows, columns + int(first.max())), -np.inf)
    for row, begin, values_m in zip(sheared_m, first, hiding_m, strict=True):
        row[begin : begin + columns] = values_m
    sheared_m = maximum_filter1d(sheared_m, 2 * lateral + 1, axis=1, mode="constant", cval=-np.inf)
    passed_m = rise_m * np.arange(rows)[:, None]
    highest_m = np.maximum.accumulate((sheared_m - passed_m)[::-1])[::-1]
    # In the block of a ray's beginning, and in the next one, it may not have risen yet.
    highest_m += passed_m + rise_m
    return np.stack([row[i : i + columns] for row, i in zip(highest_m, first, strict=True)])


def _block(along_m: FloatArray, start_m: float, size_m: float, count: int) -> NDArray[np.intp]:
    """Return the (R,) numbers of blocks along an axis, with those beyond the ground."""
    place = (along_m - start_m) * (1 / size_m)
    place += 1
    return np.asarray(np.clip(place, 0, count - 1, out=place).astype(np.intp))
