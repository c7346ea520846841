"""A probabilistic roadmap through known free space, searched by Dijkstra's algorithm.

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
"""Nearest neighbours of each position to which edges are tried."""


class Roadmap:
    """Shortest paths in known free space from one position to others."""

    def __init__(
        self,
        voxels: OccupancyMap,
        clearance_m: NDArray[np.float32],
        radius_m: float,
        start_m: FloatArray,
        positions_m: FloatArray,
    ) -> None:
        """Connect ``start_m`` (3,) and (N, 3) ``positions_m`` by straight collision-free edges."""
        self._positions_m = np.vstack((start_m, positions_m))
        count = len(self._positions_m)
        near = min(NEIGHBOURS + 1, count)
        _, neighbours = cKDTree(self._positions_m).query(self._positions_m, near)
        a = np.repeat(np.arange(count), near)
        b = np.asarray(neighbours).reshape(-1)
        # From the start all edges are tried, as the space around it is mostly known.
        a = np.concatenate((a, np.zeros(count, int)))
        b = np.concatenate((b, np.arange(count)))
        a, b = a[a != b], b[a != b]
        checker = _CollisionChecker(voxels, clearance_m, radius_m, np.asarray(start_m))
        is_clear = checker.are_free(self._positions_m[a], self._positions_m[b])
        a, b = a[is_clear], b[is_clear]
        lengths = np.linalg.norm(self._positions_m[a] - self._positions_m[b], axis=1)
        # The sparse matrix would add duplicate entries.
        pairs = np.unique(np.column_stack((a, b)), axis=0, return_index=True)[1]
        graph = coo_matrix((lengths[pairs], (a[pairs], b[pairs])), shape=(count, count))
        self._lengths_m, self._predecessors = dijkstra(
            graph.tocsr(), directed=False, indices=0, return_predecessors=True
        )

    @property
    def lengths_m(self) -> FloatArray:
        """(N,) lengths of the paths to the positions, ``+inf`` where there is none."""
        return np.asarray(self._lengths_m[1:])

    def path_m(self, index: int) -> FloatArray:
        """Return the (K, 3) waypoints of the path to a position, the start first."""
        place = index + 1
        way = [place]
        while way[-1] != 0:
            way.append(int(self._predecessors[way[-1]]))
        return np.asarray(self._positions_m[way[::-1]])


class _CollisionChecker:
    """Checks whether a ball is free: by its radius, but near the start by the clearance there.

    A view may show a surface nearer than was known, and the path away must stay free.
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
        self._start_clearance_m = min(radius_m, here_m)

    def are_free(self, starts_m: FloatArray, ends_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) which straight edges are free, checked in steps of half a voxel or less."""
        if not len(starts_m):
            return np.zeros(0, bool)
        longest_m = float(np.linalg.norm(ends_m - starts_m, axis=1).max())
        count = max(2, int(np.ceil(longest_m / (self._voxels.voxel_size_m / 2))) + 1)
        is_clear = np.ones(len(starts_m), bool)
        for share in np.linspace(0.0, 1.0, count):
            is_clear &= self._is_free(starts_m + share * (ends_m - starts_m))
        return is_clear

    def _is_free(self, points_m: FloatArray) -> NDArray[np.bool_]:
        cells, inside = self._voxels.indices(points_m)
        near = np.linalg.norm(points_m[inside] - self._start_m, axis=1) < self._radius_m
        needed_m = np.where(near, self._start_clearance_m, self._radius_m)
        is_free = inside.copy()
        is_free[inside] = self._clearance_m[tuple(cells[inside].T)] >= needed_m
        return is_free
