"""Holes in measured relief, filled by the smoothest surface that joins their rims."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import cg

from oaisys_core.types import FloatArray

MOST_ROUNDS = 500
"""Rounds after which a very large hole is smooth enough."""


def number_of_holes(missing: NDArray[np.bool_]) -> int:
    """Return how many connected regions there are, diagonal neighbours connected."""
    return int(label(missing, structure=np.ones((3, 3)))[1])


def filled(height_m: FloatArray, missing: NDArray[np.bool_]) -> FloatArray:
    """Return (rows, cols) heights where what is missing solves Laplace's equation.

    The image's own rim is free (no slope across it), so that what was never measured at an edge
    goes on level. A plane comes back as it was.

    Args:
        height_m: Heights; anything where missing.
        missing: (rows, cols), at least one of them False.
    """
    if not missing.any():
        return height_m.copy()
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    result: FloatArray = height_m[tuple(nearest)]
    system, known = _equations(result, missing)
    solution, _ = cg(system, known, x0=result[missing], rtol=1e-12, maxiter=MOST_ROUNDS)
    result[missing] = solution
    return result


def _equations(height_m: FloatArray, missing: NDArray[np.bool_]) -> tuple[csr_matrix, FloatArray]:
    """Return the matrix and right side: each unknown is the mean of its neighbours."""
    count = int(missing.sum())
    number = np.full(missing.shape, -1)
    number[missing] = np.arange(count)
    neighbours = np.zeros(count)
    known = np.zeros(count)
    pairs: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
    rows, cols = np.nonzero(missing)
    for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        r, c = rows + down, cols + right
        inside = (r >= 0) & (r < missing.shape[0]) & (c >= 0) & (c < missing.shape[1])
        neighbours += inside
        unknowns = np.flatnonzero(inside)
        other = number[r[inside], c[inside]]
        is_known = other < 0
        known[unknowns[is_known]] += height_m[r[inside], c[inside]][is_known]
        pairs.append((unknowns[~is_known], other[~is_known]))
    here = np.concatenate([np.arange(count), *(pair[0] for pair in pairs)])
    there = np.concatenate([np.arange(count), *(pair[1] for pair in pairs)])
    values = np.concatenate((neighbours, -np.ones(len(here) - count)))
    return csr_matrix((values, (here, there)), shape=(count, count)), known
