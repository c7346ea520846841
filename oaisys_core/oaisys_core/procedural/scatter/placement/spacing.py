"""Least distances between scattered objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

Pairs = NDArray[np.intp]
Sizes = FloatArray | float


@dataclass(frozen=True)
class Spacing:
    """The least distance between two objects.

    Attributes:
        of_size: Distance in units of their mean size.
        least_m: Distance in metres; the larger of both applies.
    """

    of_size: float
    least_m: float = 0.0

    def between_m(
        self, sizes_m: FloatArray | float, other_sizes_m: FloatArray | float
    ) -> FloatArray:
        """Return the least distances of pairs of objects."""
        return np.asarray(np.maximum(self.of_size * (sizes_m + other_sizes_m) / 2, self.least_m))


class OccupiedPlaces:
    """Occupied positions, stored by size so that few pairs are compared."""

    def __init__(self, spacing: Spacing) -> None:
        self._spacing = spacing
        self._trees: list[tuple[scipy.spatial.cKDTree, FloatArray]] = []

    def add(self, xy: FloatArray, sizes_m: FloatArray) -> None:
        """Occupy (N, 2) positions with objects of (N,) similar sizes."""
        if len(xy):
            self._trees.append((scipy.spatial.cKDTree(xy), sizes_m))

    def free(self, xy: FloatArray, sizes_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) which of (N, 2) positions are far enough from all occupied ones."""
        is_free = np.ones(len(xy), bool)
        if not len(xy) or self._spacing == Spacing(0.0):
            return is_free
        tree = scipy.spatial.cKDTree(xy)
        for taken, taken_m in self._trees:
            reach_m = float(self._spacing.between_m(float(sizes_m.max()), float(taken_m.max())))
            near = tree.sparse_distance_matrix(taken, reach_m, output_type="ndarray")
            i, j = near["i"], near["j"]
            too_near = near["v"] < self._spacing.between_m(sizes_m[i], taken_m[j])
            is_free[i[too_near]] = False
        return is_free


def pairs_too_near(xy: FloatArray, sizes_m: FloatArray, spacing: Spacing) -> Pairs:
    """Return (P, 2) indices, the lower first, of positions that are too close to each other."""
    if len(xy) < 2 or spacing == Spacing(0.0):
        return np.zeros((0, 2), np.intp)
    reach_m = float(spacing.between_m(float(sizes_m.max()), float(sizes_m.max())))
    pairs = np.sort(scipy.spatial.cKDTree(xy).query_pairs(reach_m, output_type="ndarray"), axis=1)
    first, second = pairs.T
    least_m = spacing.between_m(sizes_m[first], sizes_m[second])
    too_near = np.linalg.norm(xy[first] - xy[second], axis=1) < least_m
    return np.asarray(pairs[too_near])


def first_come(count: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Return which of ``count`` objects remain if those in conflict with earlier ones are removed.

    Args:
        pairs: (P, 2) indices, the lower first, of objects in conflict.
    """
    undecided, stays = 0, 1
    state = np.zeros(count, np.int8)
    while (state == undecided).any():
        # Keep all without an undecided predecessor, and drop those in conflict with them.
        waits = np.zeros(count, bool)
        waits[pairs[:, 1]] = True
        state[(state == undecided) & ~waits] = stays
        state[pairs[state[pairs[:, 0]] == stays, 1]] = -1
        pairs = pairs[(state[pairs] == undecided).all(axis=1)]
    return np.asarray(state == stays)
