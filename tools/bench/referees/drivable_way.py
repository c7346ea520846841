"""A way for a rover over the free ground of a world: as long as asked for, clear of rocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import distances_along_m
from oaisys_core.trajectory.waypoint_curve import WaypointCurve
from oaisys_core.types import FloatArray, HeightGrid

CLEARANCE_M = 0.22
"""Objects taller than this are driven around."""
MAX_SLOPE_DEG = 20.0
RADIUS_M = 1.5
"""Least distance from what cannot be driven over."""
STEP_M = 2.0
"""Between two waypoints."""
SMOOTHING_M = 1.5
ASIDE_M = 1.4
"""Between the way there and the way back."""
WAYPOINTS_PER_WAVE = 12
Cell = tuple[int, int]


@dataclass(frozen=True)
class FreeGround:
    """Where a rover can drive.

    Attributes:
        free: (H, W) cells of the connected part that reaches farthest.
        distance_m: (H, W) distances from the nearest cell that cannot be driven over.
        first_xy_m: Centre of the first cell, in ``map``.
        cell_m: Edge of a cell.
    """

    free: NDArray[np.bool_]
    distance_m: FloatArray
    first_xy_m: FloatArray
    cell_m: float

    def cell_at(self, x_m: float, y_m: float) -> Cell:
        """Return the free cell nearest to a place."""
        free = np.argwhere(self.free)
        row, column = free[np.argmin(np.linalg.norm(free - self._row_column(x_m, y_m), axis=1))]
        return int(row), int(column)

    def _row_column(self, x_m: float, y_m: float) -> FloatArray:
        return np.asarray((np.array((y_m, x_m)) - self.first_xy_m[::-1]) / self.cell_m)

    def xy_m(self, cells: FloatArray) -> FloatArray:
        """Return the centres of (N, 2) cells, row and column, as (N, 2) places in ``map``."""
        return np.asarray(self.first_xy_m + cells[:, ::-1] * self.cell_m)


def free_ground(grid: HeightGrid) -> FreeGround:
    """Return where a rover can drive on a grid of heights.

    Raises:
        InvalidInputError: Nowhere.
    """
    cell_m, ground_m = grid.spacing_m, np.asarray(grid.ground_m, dtype=np.float64)
    rise_y, rise_x = np.gradient(ndimage.gaussian_filter(ground_m, 0.6 / cell_m), cell_m)
    blocked = np.degrees(np.arctan(np.hypot(rise_x, rise_y))) > MAX_SLOPE_DEG
    blocked |= np.asarray(grid.surface_m) - ground_m > CLEARANCE_M
    blocked |= ~np.isfinite(ground_m)
    edge = int(np.ceil(RADIUS_M / cell_m)) + 4
    blocked[:edge] = blocked[-edge:] = True
    blocked[:, :edge] = blocked[:, -edge:] = True
    distance_m = ndimage.distance_transform_edt(~blocked) * cell_m
    parts, count = ndimage.label(distance_m > RADIUS_M, np.ones((3, 3)))
    if not count:
        raise InvalidInputError("world", "no free ground", "ground on which a rover can drive")
    # The longest way is there: along a canyon's floor, not on the wider plain above it.
    reach = [
        np.hypot(*(side.stop - side.start for side in box)) for box in ndimage.find_objects(parts)
    ]
    free = parts == 1 + int(np.argmax(reach))
    return FreeGround(free, distance_m, np.asarray(grid.origin_xy_m, dtype=np.float64), cell_m)


def there_and_back(ground: FreeGround) -> FloatArray:
    """Return (N, 2) waypoints to about the farthest place and back, `ASIDE_M` beside each other."""
    graph = _graph(ground)
    one = _farthest(ground, graph, ground.cell_at(0.0, 0.0))
    other = _farthest(ground, graph, one)
    line = _smooth_line(ground.xy_m(np.array(_shortest(ground, graph, one, other), np.float64)))
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left_m = ahead[:, ::-1] * (-ASIDE_M / 2, ASIDE_M / 2)
    angles = np.radians((-45.0, 0.0, 45.0))[:, None]
    turn = np.cos(angles) * ahead[-1] * ASIDE_M / 2 + np.sin(angles) * left_m[-1]
    return np.concatenate((line - left_m, line[-1] + turn, (line + left_m)[::-1]))


def slalom(way_m: FloatArray, aside_m: float, wave_m: float) -> FloatArray:
    """Return waypoints that swing to the left and right of a way in sine waves.

    Args:
        way_m: (N, 2) waypoints, with curves whose radii are larger than ``aside_m``.
        aside_m: Amplitude; the first wave reaches it at its end.
        wave_m: Length of a wave along the way.
    """
    curve = WaypointCurve(way_m)
    along_m = np.arange(0.0, curve.length_m, wave_m / WAYPOINTS_PER_WAVE)
    left = curve.tangent(along_m)[:, ::-1] * (-1.0, 1.0)
    waves = np.minimum(along_m / wave_m, 1.0) * np.sin(2 * np.pi * along_m / wave_m)
    return np.asarray(curve.position_m(along_m) + left * (aside_m * waves)[:, None])


def _graph(ground: FreeGround) -> csr_matrix:
    """Return the costs between free neighbours: their distance, more near what is not free."""
    height, width = ground.free.shape
    index = np.arange(height * width).reshape(height, width)
    cost = 1 + np.exp(RADIUS_M - ground.distance_m)
    froms, tos, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, height - down), slice(max(0, -right), width - max(0, right))
        there = slice(down, height), slice(max(0, right), width + min(0, right))
        both = ground.free[here] & ground.free[there]
        froms.append(index[here][both])
        tos.append(index[there][both])
        costs.append(np.hypot(down, right) * (cost[here] + cost[there])[both] / 2)
    entries = np.concatenate(froms), np.concatenate(tos)
    return coo_matrix((np.concatenate(costs), entries), shape=(index.size,) * 2).tocsr()


def _farthest(ground: FreeGround, graph: csr_matrix, start: Cell) -> Cell:
    row, column = start
    width = ground.free.shape[1]
    costs = dijkstra(graph, directed=False, indices=row * width + column)
    found = int(np.argmax(np.where(np.isfinite(costs), costs, -1.0)))
    return found // width, found % width


def _shortest(ground: FreeGround, graph: csr_matrix, start: Cell, end: Cell) -> list[Cell]:
    """Return the cells of the cheapest way, without the first.

    Raises:
        InvalidInputError: There is none.
    """
    width = ground.free.shape[1]
    first, last = (row * width + column for row, column in (start, end))
    _, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    way = []
    while last != first:
        if last < 0:
            raise InvalidInputError("world", "no way around", "connected free ground")
        way.append((last // width, last % width))
        last = int(before[last])
    return way[::-1]


def _smooth_line(xy_m: FloatArray) -> FloatArray:
    """Return points of a smooth line along (N, 2) places, `STEP_M` apart."""
    along_m = distances_along_m(xy_m)
    fine_m = np.arange(0.0, along_m[-1], 0.1)
    line = np.stack([np.interp(fine_m, along_m, each) for each in xy_m.T], axis=-1)
    # Odd reflection keeps the ends where they are.
    around = int(4 * SMOOTHING_M / 0.1)
    padded = np.pad(line, ((around, around), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = ndimage.gaussian_filter1d(padded, SMOOTHING_M / 0.1, axis=0)[around:-around]
    return np.asarray(smooth[:: int(STEP_M / 0.1)])
