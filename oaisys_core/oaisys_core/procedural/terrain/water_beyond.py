"""Water that goes on from a stage onto the land around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.surroundings.border import MESH_INSET
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.surroundings.land import curvature_drop_m
from oaisys_core.procedural.terrain.water import (
    FIRST_WATER_ID,
    MARGIN,
    MAX_PONDS,
    Water,
    WaterParts,
    sheet_triangles,
    water_mesh,
)
from oaisys_core.scene import FarGround, MeshPrototype, Placement
from oaisys_core.types import FloatArray

Extent = tuple[float, float, float, float]

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
    stage = land.stage
    x0, y0, x1, y1 = stage.extent_m
    (x_m, first_col), (y_m, first_row) = _lines(x0, x1), _lines(y0, y1)
    rows = slice(first_row, first_row + STAGE_CELLS)
    inside = (rows, slice(first_col, first_col + STAGE_CELLS))
    around = GroundAround(stage, land)
    corner_m = _depths_m(x_m, y_m, around, water, body_radius_m)
    middle_m = _depths_m(_between(x_m), _between(y_m), around, water, body_radius_m)
    deepest_m = np.maximum.reduce(
        [middle_m, corner_m[:-1, :-1], corner_m[:-1, 1:], corner_m[1:, :-1], corner_m[1:, 1:]]
    )
    is_wet = deepest_m > 0
    is_wet[inside] = False
    seeds = _at_edge(x_m, y_m, inside, around, water)
    ponds, _ = scipy.ndimage.label(is_wet | seeds, np.ones((3, 3), bool))
    joined = np.unique(ponds[seeds])
    sizes = np.bincount(ponds.ravel())[joined]
    largest_first = joined[np.argsort(-sizes, kind="stable")]
    prototypes: list[MeshPrototype] = []
    placements: list[Placement] = []
    T = np.eye(4)[None]
    for number in range(min(len(joined), MAX_BEYOND)):
        last = None if number == MAX_BEYOND - 1 else number + 1
        pond = np.isin(ponds, largest_first[number:last])
        cells = scipy.ndimage.binary_dilation(pond, np.ones((3, 3), bool), iterations=MARGIN)
        cells[inside] = False
        used, triangles = sheet_triangles(cells)
        row, column = np.divmod(used, len(x_m))
        xy_m = np.column_stack((x_m[column], y_m[row]))
        level_m = _levels_m(xy_m, stage.extent_m, water, body_radius_m)
        depth_m = np.where(
            _is_coarse(x_m, column) | _is_coarse(y_m, row),
            _deepest_beside(deepest_m)[row, column],
            corner_m[row, column],
        )
        vertices_m = np.column_stack((xy_m, level_m))
        name = f"water_beyond_{number + 1}"
        prototypes.append(water_mesh(name, vertices_m, triangles, depth_m, water.look))
        ids = np.array([FIRST_BEYOND_ID + number], np.uint32)
        placements.append(Placement(number, water.semantic_ids, T, ids, on_land=True))
    parts = WaterParts(tuple(prototypes), tuple(placements))
    whole = np.isin(ponds, joined)
    extent_m = _extent_m(x_m, y_m, whole, stage.extent_m)
    return WaterBeyond(parts, extent_m, x_m, y_m, whole, land, water, body_radius_m)


def _lines(low_m: float, high_m: float) -> tuple[FloatArray, int]:
    """Return the borders of cells along an axis, and the index of the stage's first cell."""
    cell_m = (high_m - low_m) / STAGE_CELLS
    count = int(np.ceil(np.log1p(REACH_M * (GROWTH - 1) / cell_m) / np.log(GROWTH)))
    away_m = np.cumsum(cell_m * GROWTH ** np.arange(count))
    on_stage_m = np.linspace(low_m, high_m, STAGE_CELLS + 1)
    return np.concatenate((low_m - away_m[::-1], on_stage_m, high_m + away_m)), count


def _between(lines_m: FloatArray) -> FloatArray:
    return np.asarray((lines_m[1:] + lines_m[:-1]) / 2)


def _is_coarse(lines_m: FloatArray, index: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether cells are so long beside (N,) of their borders that shores lie within them."""
    length_m = np.diff(lines_m)
    longest_m = np.maximum(np.append(length_m, 0.0), np.append(0.0, length_m))
    return np.asarray(longest_m[index] > 2 * length_m.min())


def _levels_m(xy_m: FloatArray, extent_m: Extent, water: Water, body_radius_m: float) -> FloatArray:
    """Return the (N,) heights of the water's surface, which is curved as the land is."""
    x0, y0, x1, y1 = extent_m
    outside_m = np.maximum(np.maximum((x0, y0) - xy_m, xy_m - (x1, y1)), 0.0)
    return water.level_m - curvature_drop_m(np.hypot(*outside_m.T), body_radius_m)


def _depths_m(
    x_m: FloatArray, y_m: FloatArray, ground: GroundAround, water: Water, body_radius_m: float
) -> FloatArray:
    """Return how deep the ground is below the level at the points of a grid, row by row."""
    x, y = np.meshgrid(x_m, y_m)
    xy_m = np.column_stack((x.ravel(), y.ravel()))
    level_m = _levels_m(xy_m, ground.extent_m, water, body_radius_m)
    depth_m = np.nan_to_num(level_m - ground.height_at(xy_m), nan=-np.inf)
    return np.asarray(depth_m.reshape(x.shape))


def _deepest_beside(deepest_m: FloatArray) -> FloatArray:
    """Return the (R + 1, C + 1) greatest depth of the cells around each corner of (R, C) cells."""
    padded = np.pad(deepest_m, 1, constant_values=-np.inf)
    return np.asarray(
        np.maximum.reduce([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    )


def _at_edge(
    x_m: FloatArray,
    y_m: FloatArray,
    inside: tuple[slice, slice],
    ground: GroundAround,
    water: Water,
) -> NDArray[np.bool_]:
    """Return the cells beyond the stage at whose side the stage is under water at its edge."""
    rows, columns = inside
    is_seed = np.zeros((len(y_m) - 1, len(x_m) - 1), bool)
    x0, y0, x1, y1 = ground.extent_m
    inset_m = MESH_INSET * np.array((x1 - x0, y1 - y0))
    share = (np.arange(EDGE_POINTS) + 0.5) / EDGE_POINTS
    for axis, lines_m, cells in ((0, x_m, columns), (1, y_m, rows)):
        first_m = lines_m[cells]
        length_m = lines_m[cells.start + 1 : cells.stop + 1] - first_m
        along_m = first_m[:, None] + share * length_m[:, None]
        for across_m, beyond in (
            ((y0, x0)[axis] + inset_m[1 - axis], (rows, columns)[axis].start - 1),
            ((y1, x1)[axis] - inset_m[1 - axis], (rows, columns)[axis].stop),
        ):
            xy_m = np.empty((along_m.size, 2))
            xy_m[:, axis], xy_m[:, 1 - axis] = along_m.ravel(), across_m
            depth_m = (water.level_m - ground.height_at(xy_m)).reshape(along_m.shape)
            is_under = (np.nan_to_num(depth_m, nan=-1.0) > 0).any(axis=1)
            place = (beyond, cells) if axis == 0 else (cells, beyond)
            is_seed[place] |= is_under
    return is_seed


def _extent_m(
    x_m: FloatArray, y_m: FloatArray, is_wet: NDArray[np.bool_], stage_m: Extent
) -> Extent:
    """Return the bounds of the stage and of some cells."""
    rows, columns = np.flatnonzero(is_wet.any(axis=1)), np.flatnonzero(is_wet.any(axis=0))
    if not len(rows):
        return stage_m
    x0, y0, x1, y1 = stage_m
    return (
        min(x0, float(x_m[columns[0]])),
        min(y0, float(y_m[rows[0]])),
        max(x1, float(x_m[columns[-1] + 1])),
        max(y1, float(y_m[rows[-1] + 1])),
    )
