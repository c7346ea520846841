"""Water that goes on from a stage onto the land around it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.surroundings.border import MESH_INSET, distance_from_m
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.surroundings.land import curvature_drop_m
from oaisys_core.procedural.terrain.water.ponds import (
    FIRST_WATER_ID,
    MARGIN,
    MAX_PONDS,
    Water,
    WaterLook,
    WaterParts,
    sheet_triangles,
    water_mesh,
)
from oaisys_core.scene import FarGround, MeshPrototype, Placement
from oaisys_core.types import Extent, FloatArray

FIRST_BEYOND_ID, MAX_BEYOND = FIRST_WATER_ID + MAX_PONDS, 30
"""Instance ids of water on the land, from the largest on; all smaller ones are one, with the last
id."""

STAGE_CELLS, GROWTH, REACH_M = 32, 1.15, 3000.0
"""Cells along an edge of the stage, how much longer each one beyond is than the one before, and
the distance from the stage at which they end."""

EDGE_POINTS = 8
"""Points of a cell's side at which the stage is looked at for water that goes on beyond it."""


@dataclass(frozen=True, eq=False)
class WaterBeyond:
    """The water on the land around a stage.

    Attributes:
        parts: Its surfaces.
        extent_m: (min_x, min_y, max_x, max_y) that holds the stage and all of this water.
        x_m, y_m: Borders of the columns and rows of cells.
        is_wet: (R, C) cells that have some of it.
        land: The ground below it.
        water: That of the stage.
        body_radius_m: Radius of the body, whose surface it follows.
    """

    parts: WaterParts
    extent_m: Extent
    x_m: FloatArray
    y_m: FloatArray
    is_wet: NDArray[np.bool_]
    land: FarGround
    water: Water
    body_radius_m: float

    def covers(self, xy_m: FloatArray, depth_m: float = 0.0) -> NDArray[np.bool_]:
        """Return whether the land is under more water than ``depth_m`` at (N, 2) points."""
        column = np.searchsorted(self.x_m, xy_m[:, 0]) - 1
        row = np.searchsorted(self.y_m, xy_m[:, 1]) - 1
        rows, columns = self.is_wet.shape
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        found = inside.copy()
        found[inside] = self.is_wet[row[inside], column[inside]]
        points_m = xy_m[found]
        level_m = _levels_m(points_m, self.land.stage.extent_m, self.water, self.body_radius_m)
        found[found] = self.land.height_at(points_m) < level_m - depth_m
        return found


def water_beyond(water: Water, land: FarGround, body_radius_m: float) -> WaterBeyond:
    """Return the water on the land that is joined to that of the stage at its edge."""
    grid = _grid_around(water, land, body_radius_m)
    seeds = _at_edge(grid, GroundAround(land.stage, land), water)
    is_wet = (grid.deepest_m > 0) | seeds
    is_wet[grid.inside] = False
    ponds, _ = scipy.ndimage.label(is_wet, np.ones((3, 3), bool))
    joined = np.unique(ponds[seeds])
    largest_first = joined[np.argsort(-np.bincount(ponds.ravel())[joined], kind="stable")]
    prototypes: list[MeshPrototype] = []
    placements: list[Placement] = []
    is_free = np.ones(ponds.shape, bool)
    is_free[grid.inside] = False
    for number in range(min(len(joined), MAX_BEYOND)):
        last = None if number == MAX_BEYOND - 1 else number + 1
        pond = np.isin(ponds, largest_first[number:last])
        cells = scipy.ndimage.binary_dilation(pond, np.ones((3, 3), bool), iterations=MARGIN)
        cells &= is_free  # a cell between two belongs to the larger one
        is_free &= ~cells
        prototypes.append(_surface(f"water_beyond_{number + 1}", cells, grid, water.look))
        ids = np.array([FIRST_BEYOND_ID + number], np.uint32)
        placements.append(Placement(number, water.semantic_ids, np.eye(4)[None], ids, on_land=True))
    parts = WaterParts(tuple(prototypes), tuple(placements))
    whole = np.isin(ponds, joined)
    extent_m = _extent_m(grid, whole, land.stage.extent_m)
    return WaterBeyond(parts, extent_m, grid.x_m, grid.y_m, whole, land, water, body_radius_m)


class _Grid(NamedTuple):
    """R x C cells of the stage and the land around it, larger with the distance from the stage.

    Attributes:
        x_m, y_m: (C + 1,) and (R + 1,) borders of the columns and rows.
        inside: Rows and columns of the stage.
        level_m: (R + 1, C + 1) heights of water at the corners.
        depth_m: (R + 1, C + 1) depths of the ground below that.
        deepest_m: (R, C) greatest depths at the corners and the middle.
    """

    x_m: FloatArray
    y_m: FloatArray
    inside: tuple[slice, slice]
    level_m: FloatArray
    depth_m: FloatArray
    deepest_m: FloatArray


def _grid_around(water: Water, land: FarGround, body_radius_m: float) -> _Grid:
    x0, y0, x1, y1 = land.stage.extent_m
    (x_m, first_col), (y_m, first_row) = _lines(x0, x1), _lines(y0, y1)
    rows, columns = (slice(first, first + STAGE_CELLS) for first in (first_row, first_col))
    around = GroundAround(land.stage, land)

    def at(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return levels and depths at the points of a grid."""
        xy_m = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        level_m = _levels_m(xy_m, land.stage.extent_m, water, body_radius_m)
        depth_m = np.nan_to_num(level_m - around.height_at(xy_m), nan=-np.inf)
        return level_m.reshape(len(y), -1), depth_m.reshape(len(y), -1)

    level_m, depth_m = at(x_m, y_m)
    _, middle_m = at((x_m[1:] + x_m[:-1]) / 2, (y_m[1:] + y_m[:-1]) / 2)
    corners_m = [depth_m[:-1, :-1], depth_m[:-1, 1:], depth_m[1:, :-1], depth_m[1:, 1:]]
    deepest_m = np.maximum.reduce([middle_m, *corners_m])
    return _Grid(x_m, y_m, (rows, columns), level_m, depth_m, deepest_m)


def _surface(name: str, cells: NDArray[np.bool_], grid: _Grid, look: WaterLook) -> MeshPrototype:
    """Return the water of some cells."""
    used, triangles = sheet_triangles(cells)
    row, column = np.divmod(used, len(grid.x_m))
    vertices_m = np.column_stack((grid.x_m[column], grid.y_m[row], grid.level_m[row, column]))
    depth_m = np.where(
        _is_coarse(grid.x_m, column) | _is_coarse(grid.y_m, row),
        _deepest_beside(grid.deepest_m)[row, column],
        grid.depth_m[row, column],
    )
    return water_mesh(name, vertices_m, triangles, depth_m, look)


def _lines(low_m: float, high_m: float) -> tuple[FloatArray, int]:
    """Return the borders of cells along an axis, and the index of the stage's first cell."""
    cell_m = (high_m - low_m) / STAGE_CELLS
    count = int(np.ceil(np.log1p(REACH_M * (GROWTH - 1) / cell_m) / np.log(GROWTH)))
    away_m = np.cumsum(cell_m * GROWTH ** np.arange(count))
    on_stage_m = np.linspace(low_m, high_m, STAGE_CELLS + 1)
    return np.concatenate((low_m - away_m[::-1], on_stage_m, high_m + away_m)), count


def _is_coarse(lines_m: FloatArray, index: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether cells are so long beside (N,) of their borders that shores lie within them."""
    length_m = np.diff(lines_m)
    longest_m = np.maximum(np.append(length_m, 0.0), np.append(0.0, length_m))
    return np.asarray(longest_m[index] > 2 * length_m.min())


def _levels_m(xy_m: FloatArray, extent_m: Extent, water: Water, body_radius_m: float) -> FloatArray:
    """Return the (N,) heights of the water's surface, which is curved as the land is."""
    return water.level_m - curvature_drop_m(distance_from_m(extent_m, xy_m), body_radius_m)


def _deepest_beside(deepest_m: FloatArray) -> FloatArray:
    """Return the (R + 1, C + 1) greatest depth of the cells around each corner of (R, C) cells."""
    padded = np.pad(deepest_m, 1, constant_values=-np.inf)
    return np.asarray(
        np.maximum.reduce([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    )


def _at_edge(grid: _Grid, ground: GroundAround, water: Water) -> NDArray[np.bool_]:
    """Return the cells beyond the stage at whose side the stage is under water at its edge."""
    is_seed = np.zeros(grid.deepest_m.shape, bool)
    low_m, high_m = np.reshape(ground.extent_m, (2, 2))
    inset_m = MESH_INSET * (high_m - low_m)
    share = (np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS
    rows, columns = grid.inside
    for axis, lines_m, along, across in (
        (0, grid.x_m, columns, rows),
        (1, grid.y_m, rows, columns),
    ):
        other = 1 - axis
        first_m, last_m = lines_m[along], lines_m[along.start + 1 : along.stop + 1]
        points_m = np.empty((STAGE_CELLS, EDGE_POINTS, 2))
        points_m[..., axis] = first_m[:, None] + share * (last_m - first_m)[:, None]
        for edge_m, beyond in (
            (low_m[other] + inset_m[other], across.start - 1),
            (high_m[other] - inset_m[other], across.stop),
        ):
            points_m[..., other] = edge_m
            height_m = ground.height_at(points_m.reshape(-1, 2)).reshape(points_m.shape[:2])
            is_under = (height_m < water.level_m).any(axis=1)
            is_seed[(beyond, along) if axis == 0 else (along, beyond)] = is_under
    return is_seed


def _extent_m(grid: _Grid, is_wet: NDArray[np.bool_], stage_m: Extent) -> Extent:
    """Return the bounds of the stage and of some cells."""
    rows, columns = np.flatnonzero(is_wet.any(axis=1)), np.flatnonzero(is_wet.any(axis=0))
    if not len(rows):
        return stage_m
    x0, y0, x1, y1 = stage_m
    return (
        min(x0, float(grid.x_m[columns[0]])),
        min(y0, float(grid.y_m[rows[0]])),
        max(x1, float(grid.x_m[columns[-1] + 1])),
        max(y1, float(grid.y_m[rows[-1] + 1])),
    )
