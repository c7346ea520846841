"""Where water runs on a grid: receivers, ways out of depressions, and drained areas.

Water flows to one of the eight neighbours, drawn anew each time with chances that favour the
steepest, so that valleys do not follow the grid. Depressions spill over their lowest passes, found
by the minimum spanning tree of basins (Cordonnier, Bovy and Braun, "A versatile, linear complexity
algorithm for flow routing in topographies with depressions", Earth Surf. Dynam. 7, 2019): O(N).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

Index = NDArray[np.int32]
Mask = NDArray[np.bool_]

STRAIGHT = ((0, 1), (1, 0), (0, -1), (-1, 0))

FACETS = tuple(
    (here, there)
    for here in STRAIGHT
    for there in STRAIGHT
    if here[0] * there[0] == here[1] * there[1]
)
"""(row, column) offsets of a straight neighbour, and from it to a diagonal one."""

HALF = ((0, 1), (1, 0), (1, 1), (1, -1))
"""One offset of each pair of opposite neighbours."""

BLOCK = 1 << 14
"""Cells whose receivers are found at once, so that they stay in the processor's cache."""

FAR_M = np.float32(1e15)
"""Height of what lies beyond the grid: no water runs there."""


class FlowNetwork(NamedTuple):
    """A forest of N cells, each of which drains into a cell earlier in the order.

    Attributes:
        order: (N,) cells, from the outlets upwards.
        receiver: (N,) places in the order of the cells that these drain into, never falling; an
            outlet has its own place.
        length_m: (N,) distances to these cells, in the order; 1 at outlets.
        bounds: Places at which levels begin, which are equally many cells from an outlet, and N.
    """

    order: Index
    receiver: Index
    length_m: FloatArray
    bounds: tuple[int, ...]

    def levels(self) -> Iterator[tuple[slice, Index]]:
        """Yield the places and the receivers of each level above the outlets, upwards."""
        for first, last in zip(self.bounds[1:-1], self.bounds[2:], strict=True):
            yield slice(first, last), self.receiver[first:last]

    def accumulate(self, amount: FloatArray) -> FloatArray:
        """Return (N,) sums over each cell and all that drain through it, in the order."""
        total = amount.copy()
        pairs = list(zip(self.bounds[1:-1], self.bounds[2:], strict=True))
        for first, last in reversed(pairs):
            into = self.receiver[first:last]
            low = int(into[0])
            flows = np.bincount(into - low, weights=total[first:last])
            total[low : low + len(flows)] += flows
        return total

    def on_grid(self, values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """Return (rows, cols) values of (N,) values in the order."""
        grid = np.empty(len(values))
        grid[self.order] = values
        return grid.reshape(shape)


def route(
    elevation_m: FloatArray,
    spacing_m: float,
    rng: np.random.Generator | None,
    outlets: Mask | None = None,
) -> FlowNetwork:
    """Return where the water of each cell runs; from every cell it reaches an outlet.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        rng: Draws the directions; None for the steepest.
        outlets: (rows, cols) cells where water leaves; None for those of the edges.
    """
    if outlets is None:
        outlets = edge_cells(elevation_m.shape)
    receiver = _receivers(elevation_m, rng)
    cells = np.arange(elevation_m.size, dtype=np.int32)
    is_outlet = outlets.ravel()
    receiver[is_outlet] = cells[is_outlet]
    _leave_depressions(receiver, elevation_m, is_outlet)
    return _in_order(receiver, elevation_m.shape[1], spacing_m)


def edge_cells(shape: tuple[int, ...]) -> Mask:
    """Return (rows, cols) whether a cell is at an edge of the grid."""
    cells = np.ones(shape, bool)
    cells[1:-1, 1:-1] = False
    return cells


def pair(
    shape: tuple[int, ...], row: int, col: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of the cells that have a neighbour at an offset, and of these neighbours."""
    rows, cols = shape
    here = (slice(max(-row, 0), rows - max(row, 0)), slice(max(-col, 0), cols - max(col, 0)))
    there = (slice(max(row, 0), rows - max(-row, 0)), slice(max(col, 0), cols - max(-col, 0)))
    return here, there


def _receivers(z: FloatArray, rng: np.random.Generator | None) -> Index:
    """Return the (N,) cells that each one drains into; pits have themselves.

    Of the eight triangles around a cell, water runs down the steepest (Tarboton, WRR 33(2), 1997),
    to that of its two far corners which is drawn, so that it runs straight down on the average.
    """
    height = np.pad(z.astype(np.float32), 1, constant_values=FAR_M)
    rows, cols = z.shape
    share = np.full(z.shape, 0.5, np.float32) if rng is None else rng.random(z.shape, np.float32)
    towards = np.empty(z.shape, np.int32)
    step = max(1, BLOCK // cols)
    for first in range(0, rows, step):
        block = slice(first, min(first + step, rows))
        towards[block] = _offsets(height[first : block.stop + 2], share[block])
    return np.arange(z.size, dtype=np.int32) + towards.ravel()


def _offsets(padded: NDArray[np.float32], share: NDArray[np.float32]) -> Index:
    """Return (rows, cols) differences of the numbers of the next cell and the own one.

    Args:
        padded: (rows + 2, cols + 2) heights, with those of the cells around.
        share: (rows, cols) draws from 0 to 1.
    """
    cols = share.shape[1]
    steepest = np.zeros(share.shape, np.float32)
    towards = np.zeros(share.shape, np.int32)
    for (row, col), turn in FACETS:
        near = _fall(padded, (row, col))
        far = _fall(padded, (row + turn[0], col + turn[1]))
        is_up = near <= 0
        np.maximum(near, 0, out=near)
        across = far - near
        np.maximum(across, 0, out=across)
        np.minimum(across, near, out=across)
        goes_across = across > share * near
        goes_across |= is_up
        # Beyond the diagonal, the slope along it counts.
        is_beyond = far > 2 * near
        across *= across
        near *= near
        across += near
        slope = np.sqrt(across, out=across)
        far *= np.float32(np.sqrt(0.5))
        np.copyto(slope, far, where=is_beyond)
        better = slope > steepest
        np.copyto(steepest, slope, where=better)
        straight = np.int32(row * cols + col)
        diagonal = np.int32((row + turn[0]) * cols + col + turn[1])
        np.copyto(towards, np.where(goes_across, diagonal, straight), where=better)
    return towards


def _fall(padded: NDArray[np.float32], offset: tuple[int, int]) -> NDArray[np.float32]:
    rows, cols = (size - 2 for size in padded.shape)
    row, col = 1 + offset[0], 1 + offset[1]
    return padded[1:-1, 1:-1] - padded[row : row + rows, col : col + cols]


def _leave_depressions(receiver: Index, z: FloatArray, is_outlet: Mask) -> None:
    """Turn the ways of water in each basin without an outlet towards its lowest way out."""
    cells = np.arange(len(receiver), dtype=np.int32)
    is_pit = (receiver == cells) & ~is_outlet
    pits = np.flatnonzero(is_pit)
    if not len(pits):
        return
    basin_of_root = np.zeros(len(receiver), np.int32)
    basin_of_root[pits] = np.arange(1, len(pits) + 1)
    basin = basin_of_root[_roots(receiver)]
    inside, outside = _ways_out(basin.reshape(z.shape), z, len(pits) + 1)
    _reverse(receiver, inside, outside)


def _roots(receiver: Index) -> Index:
    """Return the (N,) cells where the water of each cell ends."""
    root = receiver
    while True:
        further = root[root]
        if np.array_equal(further, root):
            return root
        root = further


def _ways_out(basin: Index, z: FloatArray, count: int) -> tuple[Index, Index]:
    """Return for each basin but 0 the cell at which water leaves it, and the next one."""
    one, other = _passes(basin)
    flat, height = basin.ravel(), z.ravel()
    low, high = np.minimum(flat[one], flat[other]), np.maximum(flat[one], flat[other])
    level = np.maximum(height[one], height[other])
    chosen = _lowest(low.astype(np.int64) * count + high, level)
    # Ranks instead of heights, so that the tree is the same everywhere.
    chosen = chosen[np.argsort(level[chosen], kind="stable")]
    rank = np.arange(1.0, len(chosen) + 1)
    graph = scipy.sparse.csr_matrix((rank, (low[chosen], high[chosen])), (count, count))
    tree = scipy.sparse.csgraph.minimum_spanning_tree(graph)
    tree = (tree + tree.T).tocsr()
    _, parent = scipy.sparse.csgraph.breadth_first_order(tree, 0, directed=False)
    child = np.arange(1, count)
    via = np.asarray(tree[child, parent[1:]]).ravel().astype(np.int64) - 1
    crossing = chosen[via]
    one, other = one[crossing], other[crossing]
    is_one = flat[one] == child
    return np.where(is_one, one, other), np.where(is_one, other, one)


def _lowest(key: NDArray[np.int64], level: FloatArray) -> NDArray[np.intp]:
    """Return the places, in their order, of the first lowest one of the passes with each key."""
    order = np.argsort(key, kind="stable")
    key, level = key[order], level[order]
    starts = np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1])))
    lengths = np.diff(np.append(starts, len(key)))
    least = np.repeat(np.minimum.reduceat(level, starts), lengths)
    found = np.flatnonzero(level == least)
    first = np.concatenate(([True], key[found[1:]] != key[found[:-1]]))
    return np.sort(order[found[first]])


def _passes(basin: Index) -> tuple[Index, Index]:
    """Return the pairs of neighbouring cells of different basins."""
    index = np.arange(basin.size, dtype=np.int32).reshape(basin.shape)
    pairs = []
    for row, col in HALF:
        here, there = pair(basin.shape, row, col)
        differ = basin[here] != basin[there]
        pairs.append((index[here][differ], index[there][differ]))
    one, other = (np.concatenate(side) for side in zip(*pairs, strict=True))
    return one, other


def _reverse(receiver: Index, inside: Index, outside: Index) -> None:
    """Let the water run from each pit to ``inside``, against its former way, and out."""
    cell, after = inside, outside
    while len(cell):
        before = receiver[cell]
        receiver[cell] = after
        goes_on = before != cell
        cell, after = before[goes_on], cell[goes_on]


def _in_order(receiver: Index, cols: int, spacing_m: float) -> FlowNetwork:
    count = len(receiver)
    cells = np.arange(count, dtype=np.int32)
    is_root = receiver == cells
    # The graph's arrows lead upwards from a node that all outlets hang on.
    source = np.where(is_root, np.int32(count), receiver)
    shape = (count + 1, count + 1)
    graph = scipy.sparse.csr_matrix((np.ones(count), (source, cells)), shape)
    order = scipy.sparse.csgraph.breadth_first_order(graph, count, return_predecessors=False)
    order = order[1:].astype(np.int32)
    place = np.empty(count, np.int32)
    place[order] = cells
    into = receiver[order]
    placed = place[into]
    step = np.abs(order - into)
    diagonal = (step == cols - 1) | (step == cols + 1)
    length_m = spacing_m * np.where(diagonal, np.sqrt(2.0), 1.0)
    outlets = int(is_root.sum())
    bounds = [0, outlets]
    above = placed[outlets:]
    while bounds[-1] < count:
        # An int32, or NumPy would convert all of the array.
        bounds.append(outlets + int(np.searchsorted(above, np.int32(bounds[-1]))))
    length_m[:outlets] = 1.0
    return FlowNetwork(order, placed, length_m, tuple(bounds))
