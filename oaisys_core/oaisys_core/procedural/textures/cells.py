"""Cells that divide a tile, and the distance of each pixel to the border of its cell.

Cells are, for example, polygons of dried mud, blocks of rock between joints, or lobes of lava. They
are given as images of cell ids, so that cells may be warped or cut by others.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.types import FloatArray

Ids = NDArray[np.int64]


def voronoi(
    size_px: int,
    cells: int,
    rng: np.random.Generator,
    *,
    warp: float = 0.12,
    jitter: float = 0.4,
    smooth: float = 2.4,
) -> Ids:
    """Return the (N, N) ids of about ``cells`` squared Voronoi cells.

    Args:
        size_px: Edge length of the tile.
        cells: Cells along an edge.
        rng: Draws the centres.
        warp: Strength of the domain warp that bends borders, in cells.
        smooth: Smoothness of the bends: 2 is ragged, 3.5 very smooth.
        jitter: Largest distance of a centre from its grid position, in cells.
    """
    x, y = fields.unit_grid(size_px, cells)
    if warp:
        x, y = fields.warp(x, y, cells, rng, warp, smooth)
    number = np.arange(cells * cells)
    offset = 0.5 + rng.uniform(-jitter, jitter, (2, cells * cells))
    centres = np.stack((number % cells, number // cells), axis=1) + offset.T
    points = np.stack((x.ravel(), y.ravel()), axis=1) % cells
    nearest = scipy.spatial.cKDTree(centres % cells, boxsize=cells).query(points)[1]
    return np.asarray(nearest.reshape(x.shape), np.int64)


def border_distance(ids: Ids, keep: NDArray[np.bool_] | None = None) -> Field:
    """Return (N, N) distances in pixels to the nearest cell border, across the tile's edges too.

    Args:
        ids: (N, N) cell ids.
        keep: (N, N) where borders count; None for everywhere.
    """
    import cv2

    border = (ids != np.roll(ids, 1, axis=0)) | (ids != np.roll(ids, 1, axis=1))
    if keep is not None:
        border &= keep
    size_px = len(ids)
    if not border.any():
        return np.full(ids.shape, size_px, np.float32)
    pad = size_px // 2
    free = np.pad((~border).astype(np.uint8), pad, mode="wrap")
    distance = cv2.distanceTransform(free, cv2.DIST_L2, 5)
    return np.asarray(distance[pad : pad + size_px, pad : pad + size_px], np.float32)


def per_cell(ids: Ids, rng: np.random.Generator) -> Field:
    """Return (N, N) random values, constant within each cell, with standard deviation 1."""
    return rng.standard_normal(int(ids.max()) + 1).astype(np.float32)[ids]


def from_centre(ids: Ids, every: int = 1) -> tuple[Field, Field]:
    """Return (N, N) column and row offsets, in tile edges, of each pixel from its cell's centre.

    The centre is a circular mean, so that cells may cross the tile's edges.

    Args:
        ids: (N, N) cell ids.
        every: Of so many rows and columns, one is looked at to find the centres.
    """
    size_px = len(ids)
    count = int(ids.max()) + 1
    axis = (np.arange(size_px) + 0.5) / size_px
    sample = ids[::every, ::every]
    turns = np.exp(2j * np.pi * axis[::every])
    away: list[Field] = []
    for place, turn in ((axis, turns), (axis[:, None], turns[:, None])):
        whole = np.broadcast_to(turn, sample.shape)
        mean = np.bincount(sample.ravel(), whole.real.ravel(), count)
        mean = mean + 1j * np.bincount(sample.ravel(), whole.imag.ravel(), count)
        centre = np.angle(mean) / (2 * np.pi)
        away.append(((place - centre[ids] + 0.5) % 1.0 - 0.5).astype(np.float32))
    return away[0], away[1]


def facet_heights(
    ids: Ids, rng: np.random.Generator, leans: FloatArray | None = None, spread: float = 0.5
) -> Field:
    """Return (N, N) heights of one tilted plane per cell, 0 at its centre.

    Slopes are normally distributed with standard deviation 1 along each axis, or around ``leans``.

    Args:
        ids: (N, N) cell ids.
        rng: Draws the slopes.
        leans: (K, 2) slopes along x and y, one of which each plane has but for ``spread``.
        spread: Standard deviation of slopes around those of ``leans``.
    """
    count = int(ids.max()) + 1
    slope = rng.standard_normal((2, count))
    if leans is not None:
        slope = leans[rng.integers(0, len(leans), count)].T + spread * slope
    x, y = from_centre(ids)
    along, across = slope.astype(np.float32)
    return np.asarray(along[ids] * x + across[ids] * y, np.float32)
