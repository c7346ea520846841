"""Filling of holes in elevation models by solving Laplace's equation."""

from __future__ import annotations

from typing import Any

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

WIDE_SHARE = 1 / 32
"""Share of missing pixels from which on equations are solved on the image itself: written down as a
matrix they need 380 bytes a pixel, which is 30 GB for half of a large model of a coast."""

BAND_ROWS = 256
"""Rows of an image that are interpolated at a time."""


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
    if is_large and missing.mean() > WIDE_SHARE:
        _solve_on_image(result, missing)
        return result
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
    down, right = ((np.arange(n) + 0.5) / COARSER - 0.5 for n in (rows, cols))
    result = height_m.astype(np.float64)
    for first in range(0, rows, BAND_ROWS):
        band = slice(first, first + BAND_ROWS)
        places = np.meshgrid(down[band], right, indexing="ij")
        finer_m = scipy.ndimage.map_coordinates(coarse_m, places, order=1, mode="nearest")
        np.copyto(result[band], finer_m, where=missing[band])
    return result


def _solve_on_image(height_m: FloatArray, missing: NDArray[np.bool_]) -> None:
    """Improve the missing heights by conjugate gradients, whose vectors are images, in place."""
    residual = _laplacian(height_m).astype(np.float32)
    residual[~missing] = 0
    direction = residual.copy()
    square = _product(residual, residual)
    for _ in range(FINE_ROUNDS):
        if not square > 0:
            break
        change = _laplacian(direction)
        change[~missing] = 0
        # The equations' matrix is that of the negative Laplacian.
        step = square / -_product(direction, change)
        height_m += np.float32(step) * direction
        residual += np.float32(step) * change
        before, square = square, _product(residual, residual)
        direction *= np.float32(square / before)
        direction += residual


def _laplacian(image: NDArray[Any]) -> NDArray[Any]:
    """Return the sum of the differences of neighbours from each pixel, of those in the image."""
    total = np.zeros_like(image)
    for along, total_along in ((image, total), (image.T, total.T)):
        rises = np.diff(along, axis=0)
        total_along[:-1] += rises
        total_along[1:] -= rises
    return total


def _product(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float((one * other).sum(dtype=np.float64))


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
