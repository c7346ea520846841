"""Tilings: how a texture is laid on the ground so that its repetition is not visible.

For each point of the ground, a tiling returns texture coordinates and their weights; the colour is
the weighted mean of the texture at these coordinates. Coordinates are in units of tiles, u to the
right and v up; the texture repeats after every whole number. Backends and label images use the
same tables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

PERIOD_CELLS = 16
"""Number of cells along each axis after which the Voronoi pattern repeats."""

CELL_PX = 32
"""Texels per Voronoi cell in the tables."""

SEAM = (0.03, 0.22)
"""Distances from a cell's edge, in cells, between which its own texture fades in."""

SHIFTS = 64
"""Number of lattice points along each axis after which stochastic shifts repeat."""

CRISPNESS = 3
"""Exponent of the weights of a stochastic tiling; higher values blend less."""


class TextureSamples(NamedTuple):
    """The K texture samples that are blended at each of N points.

    Attributes:
        uv_tiles: (K, N, 2) texture coordinates.
        weights: (K, N) weights, which sum to 1.
        turn: (2, N) cosine and sine of the angle by which the first sample's coordinates were
            turned; None: by none.
    """

    uv_tiles: FloatArray
    weights: FloatArray
    turn: FloatArray | None = None


@dataclass(frozen=True)
class PlainTiling:
    """The texture, repeated without changes."""

    def samples(self, xy_tiles: FloatArray) -> TextureSamples:
        """Return the one texture sample of each of (N, 2) points."""
        return TextureSamples(xy_tiles[None], np.ones((1, len(xy_tiles))))


@dataclass(frozen=True)
class VoronoiTiling:
    """The texture rotated and shifted in each cell of a Voronoi diagram, unchanged along the edges.

    Attributes:
        cell_tiles: Mean size of a cell.
        moves: (R, R, 3) float32 rotation in radians and shift in tiles of the cell at each texel,
            looked up at the nearest texel. Row 0 is at v = 0; it repeats after `PERIOD_CELLS`.
        weights: (R, R) float32 weight of the moved texture, interpolated bilinearly.
    """

    cell_tiles: float
    moves: NDArray[np.float32]
    weights: NDArray[np.float32]

    @property
    def period_tiles(self) -> float:
        """Edge length of the tables in tiles."""
        return self.cell_tiles * PERIOD_CELLS

    @cached_property
    def _turns_and_shifts(self) -> FloatArray:
        """(4, R * R) cosine and sine of the rotation, and shift, of each texel's cell."""
        angle_rad, *shift = self.moves.reshape(-1, 3).astype(np.float64).T
        return np.stack((np.cos(angle_rad), np.sin(angle_rad), *shift))

    def samples(self, xy_tiles: FloatArray) -> TextureSamples:
        """Return the moved and the unchanged texture sample of each of (N, 2) points."""
        size = len(self.moves)
        texel = xy_tiles / self.period_tiles * size
        column, row = (np.floor(texel).astype(np.int64) % size).T
        cos, sin, shift_u, shift_v = self._turns_and_shifts.take(row * size + column, axis=1)
        x, y = xy_tiles.T
        moved = np.column_stack((cos * x - sin * y + shift_u, sin * x + cos * y + shift_v))
        weight = _bilinear_repeated(self.weights, texel - 0.5)
        return TextureSamples(
            np.stack((moved, xy_tiles)), np.stack((weight, 1 - weight)), np.stack((cos, sin))
        )


@dataclass(frozen=True)
class StochasticTiling:
    """A shifted copy at each point of a triangular lattice, of which three are blended.

    After Heitz and Neyret, "High-Performance By-Example Noise using a Histogram-Preserving
    Blending Operator", 2018.

    Attributes:
        cell_tiles: Distance between neighbouring lattice points.
        shifts: (`SHIFTS`, `SHIFTS`, 2) float32 shift in tiles by row and column of the lattice.
    """

    cell_tiles: float
    shifts: NDArray[np.float32]

    def samples(self, xy_tiles: FloatArray) -> TextureSamples:
        """Return the texture samples of the copies at the corners of each point's triangle."""
        x, y = (xy_tiles / self.cell_tiles).T
        skewed = np.column_stack((x - y / np.sqrt(3), y * (2 / np.sqrt(3))))
        base = np.floor(skewed)
        s, t = (skewed - base).T
        is_lower = s + t < 1
        corner = np.where(is_lower, 0, 1)
        corners = base + np.stack(
            (
                np.column_stack((corner, corner)),
                np.broadcast_to((1, 0), base.shape),
                np.broadcast_to((0, 1), base.shape),
            )
        )
        weights = np.stack(
            (abs(1 - s - t), np.where(is_lower, s, 1 - t), np.where(is_lower, t, 1 - s))
        )
        weights = weights ** float(CRISPNESS)
        column, row = np.moveaxis(corners.astype(np.int64) % SHIFTS, -1, 0)
        return TextureSamples(xy_tiles + self.shifts[row, column], weights / weights.sum(axis=0))


Tiling = PlainTiling | VoronoiTiling | StochasticTiling


def voronoi_tiling(
    cell_tiles: float, rotation_rad: float, rng: np.random.Generator
) -> VoronoiTiling:
    """Return a Voronoi tiling whose cells are rotated by up to ``rotation_rad`` to either side."""
    cells, weights = _voronoi_tables()
    count = PERIOD_CELLS**2
    moves = np.column_stack(
        (rng.uniform(-rotation_rad, rotation_rad, count), rng.uniform(0, 1, (count, 2)))
    )
    return VoronoiTiling(cell_tiles, moves.astype(np.float32)[cells], weights)


def stochastic_tiling(cell_tiles: float, rng: np.random.Generator) -> StochasticTiling:
    """Return a stochastic tiling with random shifts."""
    return StochasticTiling(cell_tiles, rng.random((SHIFTS, SHIFTS, 2), dtype=np.float32))


@lru_cache(maxsize=1)
def _voronoi_tables() -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the cell at each texel of the tables, and the weight of its own texture.

    The cells come from a jittered grid that never changes; only their moves are random.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:PERIOD_CELLS, :PERIOD_CELLS]
    corners = np.column_stack((columns.ravel(), rows.ravel()))
    points = corners + rng.uniform(0.1, 0.9, (PERIOD_CELLS**2, 2))
    axis = (np.arange(PERIOD_CELLS * CELL_PX) + 0.5) / CELL_PX
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    _, near = cKDTree(points, boxsize=PERIOD_CELLS).query(places, k=8)
    to_first = _wrap(points[near[:, 0]] - places)
    edge = np.full(len(places), np.inf)
    for other in near[:, 1:].T:
        to_other = _wrap(points[other] - places)
        apart = to_other - to_first
        middle = (to_other + to_first) / 2
        edge = np.minimum(edge, (middle * apart).sum(axis=1) / np.linalg.norm(apart, axis=1))
    t = np.clip((edge - SEAM[0]) / (SEAM[1] - SEAM[0]), 0, 1)
    size = PERIOD_CELLS * CELL_PX
    weights = (t * t * (3 - 2 * t)).astype(np.float32).reshape(size, size)
    return near[:, 0].reshape(size, size), weights


def _wrap(difference: FloatArray) -> FloatArray:
    """Return the shortest differences between points of the repeating pattern."""
    return np.asarray(difference - PERIOD_CELLS * np.rint(difference / PERIOD_CELLS))


def _bilinear_repeated(image: NDArray[Any], texel: FloatArray) -> FloatArray:
    """Return (N,) bilinearly interpolated values of a square image that repeats."""
    size = len(image)
    low = np.floor(texel)
    s, t = (texel - low).T
    c0, r0 = low.astype(np.int64).T % size
    c1, r1 = (c0 + 1) % size, (r0 + 1) % size
    lower = image[r0, c0] * (1 - s) + image[r0, c1] * s
    upper = image[r1, c0] * (1 - s) + image[r1, c1] * s
    return np.asarray(lower * (1 - t) + upper * t)
