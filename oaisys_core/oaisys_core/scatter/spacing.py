"""Things that keep their distance: which of many places can be held at the same time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oaisys_core.types import FloatArray

Pairs = NDArray[np.intp]
Sizes = FloatArray | float


@dataclass(frozen=True)
class Spacing:
    """Least distance of two things.

    Attributes:
        of_size: In units of their mean size.
        least_m: In metres; the larger of the two counts.
    """

    of_size: float
    least_m: float = 0.0

    def between_m(
        self, sizes_m: FloatArray | float, other_sizes_m: FloatArray | float
    ) -> FloatArray:
        """Return the least distances of pairs of things."""
        return np.asarray(np.maximum(self.of_size * (sizes_m + other_sizes_m) / 2, self.least_m))


class OccupiedPlaces:
    """Places that are taken, kept by size so that few pairs need to be looked at."""

    def __init__(self, spacing: Spacing) -> None:
        self._spacing = spacing
        self._trees: list[tuple[cKDTree, FloatArray]] = []

    def add(self, xy: FloatArray, sizes_m: FloatArray) -> None:
        """Take (N, 2) places for things of (N,) sizes, which should not differ much."""
        if len(xy):
            self._trees.append((cKDTree(xy), sizes_m))

    def free(self, xy: FloatArray, sizes_m: FloatArray) -> NDArray[np.bool_]:
        """Return which of (N, 2) places are far enough from all taken ones."""
        is_free = np.ones(len(xy), bool)
        if not len(xy) or self._spacing == Spacing(0.0):
            return is_free
        tree = cKDTree(xy)
        for taken, taken_m in self._trees:
            reach_m = float(self._spacing.between_m(float(sizes_m.max()), float(taken_m.max())))
            near = tree.sparse_distance_matrix(taken, reach_m, output_type="ndarray")
            i, j = near["i"], near["j"]
            too_near = near["v"] < self._spacing.between_m(sizes_m[i], taken_m[j])
            is_free[i[too_near]] = False
        return is_free


def pairs_too_near(xy: FloatArray, sizes_m: FloatArray, spacing: Spacing) -> Pairs:
    """Return (P, 2) indices, the lower first, of places that cannot both be held."""
    if len(xy) < 2 or spacing == Spacing(0.0):
        return np.zeros((0, 2), np.intp)
    reach_m = float(spacing.between_m(float(sizes_m.max()), float(sizes_m.max())))
    pairs = np.sort(cKDTree(xy).query_pairs(reach_m, output_type="ndarray"), axis=1)
    first, second = pairs.T
    least_m = spacing.between_m(sizes_m[first], sizes_m[second])
    too_near = np.linalg.norm(xy[first] - xy[second], axis=1) < least_m
    return np.asarray(pairs[too_near])


def first_come(count: int, pairs: Pairs) -> NDArray[np.bool_]:
    """Return which of ``count`` things stay when each, in order, yields to those that stay before.

    Args:
        pairs: (P, 2) indices, the lower first, of which only one can stay.
    """
    undecided, stays = 0, 1
    state = np.zeros(count, np.int8)
    while (state == undecided).any():
        # Who has no undecided predecessor left stays; all in conflict with those go.
        waits = np.zeros(count, bool)
        waits[pairs[:, 1]] = True
        state[(state == undecided) & ~waits] = stays
        state[pairs[state[pairs[:, 0]] == stays, 1]] = -1
        pairs = pairs[(state[pairs] == undecided).all(axis=1)]
    return np.asarray(state == stays)
