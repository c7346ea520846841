"""Filling of holes in elevation models by solving Laplace's equation."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

MAX_ROUNDS = 500
FINE_ROUNDS = 30
"""Iterations of the solver; fewer suffice with an initial guess from a coarser image."""

LARGE_PX = 20_000
"""Number of missing pixels above which a coarser image is filled first."""

COARSER = 4
"""Reduction factor of the coarser image."""


def number_of_holes(missing: NDArray[np.bool_]) -> int:
    """Return the number of connected regions (8-connectivity)."""
    return int(scipy.ndimage.label(missing, structure=np.ones((3, 3)))[1])


def fill_holes(height_m: FloatArray, missing: NDArray[np.bool_]) -> FloatArray:
    """Return (rows, cols) heights in which the missing ones solve Laplace's equation.

    The boundary of the image has no slope across it, so that missing heights at an edge continue
    level.

    Args:
        height_m: Heights, with any values at missing pixels.
        missing: (rows, cols), at least one of them False.
    """
    from scipy.sparse.linalg import cg

    if not missing.any():
        return height_m.copy()
    is_large = bool(missing.sum() > LARGE_PX)
    result = _from_coarser(height_m, missing) if is_large else _nearest(height_m, missing)
    system, known = _equations(result, missing)
    rounds = FINE_ROUNDS if is_large else MAX_ROUNDS
    solution, _ = cg(system, known, x0=result[missing], rtol=1e-12, maxiter=rounds)
    result[missing] = solution
    return result


def _nearest(height_m: FloatArray, missing: NDArray[np.bool_]) -> FloatArray:
    """Return the heights with missing ones taken from the nearest known pixel."""
    nearest = scipy.ndimage.distance_transform_edt(
        missing, return_distances=False, return_indices=True
    )
    return np.asarray(height_m[tuple(nearest)])


def _from_coarser(height_m: FloatArray, missing: NDArray[np.bool_]) -> FloatArray:
    """Return the heights with missing ones interpolated from a filled image of lower resolution."""
    rows, cols = height_m.shape
    pad = ((0, -rows % COARSER), (0, -cols % COARSER))
    known = np.pad(~missing, pad)
    values = np.where(known, np.pad(height_m, pad), 0.0)
    blocks = (known.shape[0] // COARSER, COARSER, known.shape[1] // COARSER, COARSER)
    count = known.reshape(blocks).sum(axis=(1, 3))
    mean_m = values.reshape(blocks).sum(axis=(1, 3)) / np.maximum(count, 1)
    coarse_m = fill_holes(mean_m, count == 0)
    places = [(np.arange(n) + 0.5) / COARSER - 0.5 for n in (rows, cols)]
    finer_m = scipy.ndimage.map_coordinates(
        coarse_m, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"
    )
    return np.where(missing, finer_m, height_m)


def _equations(
    height_m: FloatArray, missing: NDArray[np.bool_]
) -> tuple[scipy.sparse.csr_matrix, FloatArray]:
    """Return the matrix and right-hand side: each unknown is the mean of its neighbours."""
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
    return scipy.sparse.csr_matrix((values, (here, there)), shape=(count, count)), known
