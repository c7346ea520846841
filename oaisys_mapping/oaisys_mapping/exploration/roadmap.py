"""Ways through known free space: a roadmap of random places, searched by Dijkstra's algorithm.

Kavraki et al., "Probabilistic roadmaps for path planning in high-dimensional configuration spaces",
IEEE T-RA 12(4), 1996.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from oaisys_core.types import FloatArray
from oaisys_mapping.exploration.occupancy_map import OccupancyMap

NEIGHBOURS = 12
"""Places that each place is tried to be joined with, the nearest ones."""


class Roadmap:
    """Shortest known ways from one place to others."""

    def __init__(
        self,
        voxels: OccupancyMap,
        clearance_m: NDArray[np.float32],
        radius_m: float,
        start_m: FloatArray,
        positions_m: FloatArray,
    ) -> None:
        """Join ``start_m`` (3,) and (N, 3) ``positions_m`` by straight ways that are clear."""
        self._places_m = np.vstack((start_m, positions_m))
        count = len(self._places_m)
        near = min(NEIGHBOURS + 1, count)
        _, neighbours = cKDTree(self._places_m).query(self._places_m, near)
        a = np.repeat(np.arange(count), near)
        b = np.asarray(neighbours).reshape(-1)
        # From the start every place is tried: it is where a wide view is most likely clear.
        a = np.concatenate((a, np.zeros(count, int)))
        b = np.concatenate((b, np.arange(count)))
        a, b = a[a != b], b[a != b]
        room = _Room(voxels, clearance_m, radius_m, np.asarray(start_m))
        clear = room.clear_ways(self._places_m[a], self._places_m[b])
        a, b = a[clear], b[clear]
        lengths = np.linalg.norm(self._places_m[a] - self._places_m[b], axis=1)
        # Doubled entries would be added up.
        pairs = np.unique(np.column_stack((a, b)), axis=0, return_index=True)[1]
        graph = coo_matrix((lengths[pairs], (a[pairs], b[pairs])), shape=(count, count))
        self._lengths_m, self._before = dijkstra(
            graph.tocsr(), directed=False, indices=0, return_predecessors=True
        )

    @property
    def lengths_m(self) -> FloatArray:
        """(N,) lengths of the ways to the positions, ``+inf`` where none is known."""
        return np.asarray(self._lengths_m[1:])

    def path_m(self, index: int) -> FloatArray:
        """Return the (K, 3) places on the way to a position, the start first."""
        place = index + 1
        way = [place]
        while way[-1] != 0:
            way.append(int(self._before[way[-1]]))
        return np.asarray(self._places_m[way[::-1]])


class _Room:
    """Where a ball has room: everywhere its radius, but around the start what it has there.

    A view may show something nearer than was known; the way out must stay open.
    """

    def __init__(
        self,
        voxels: OccupancyMap,
        clearance_m: NDArray[np.float32],
        radius_m: float,
        start_m: FloatArray,
    ) -> None:
        self._voxels = voxels
        self._clearance_m = clearance_m
        self._radius_m = radius_m
        self._start_m = start_m
        cells, inside = voxels.indices(start_m[None])
        here_m = float(clearance_m[tuple(cells[0])]) if inside[0] else 0.0
        self._least_m = min(radius_m, here_m)

    def clear_ways(self, starts_m: FloatArray, ends_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) whether straight ways are clear, in steps of half a voxel or less."""
        if not len(starts_m):
            return np.zeros(0, bool)
        longest_m = float(np.linalg.norm(ends_m - starts_m, axis=1).max())
        count = max(2, int(np.ceil(longest_m / (self._voxels.voxel_size_m / 2))) + 1)
        clear = np.ones(len(starts_m), bool)
        for share in np.linspace(0.0, 1.0, count):
            clear &= self._has_room(starts_m + share * (ends_m - starts_m))
        return clear

    def _has_room(self, points_m: FloatArray) -> NDArray[np.bool_]:
        cells, inside = self._voxels.indices(points_m)
        near = np.linalg.norm(points_m[inside] - self._start_m, axis=1) < self._radius_m
        needed_m = np.where(near, self._least_m, self._radius_m)
        has_room = inside.copy()
        has_room[inside] = self._clearance_m[tuple(cells[inside].T)] >= needed_m
        return has_room
