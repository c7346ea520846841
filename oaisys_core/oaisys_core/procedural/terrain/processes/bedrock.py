"""Bedrock between a decimetre and some metres: blocks between joints, and ledges along beds.

Rock breaks along joints, sets of nearly parallel planes, and along its beds. Where it is bare, its
surface is made of the faces of blocks: each lies as high as the ground at its middle, and its top
dips as the beds do. Blocks of several sizes lie in each other. Sums, products, quotients and roots
only: it has the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.exact import draw_direction, smooth, tangent
from oaisys_core.procedural.terrain.processes.slopes import DIAGONAL, bound_rises, steepness
from oaisys_core.types import FloatArray

LARGEST_BLOCK_M = 4.0
"""Spacing of joints, at most, whatever the size of a landform."""

SIZES = (1.0, 0.45, 0.2)
"""Spacing of joints of each size, in those of the largest."""

LEAST_CELLS = 4.0
"""Grid cells across the smallest blocks."""

BEND, BEND_BLOCKS = 0.55, 5.0
"""By how much joints bend, and the wavelength of it, in blocks."""

GAPS, SHIFTS = (0.45, 1.65), 12.0
"""Least gap between two joints and how much more it may be, in their mean spacing; and the length
within which those of the second set are shifted from row to row, in the same."""

BARE_DEG = (28.0, 46.0)
"""Slopes from which on rock is bare here and there, and everywhere."""

WALL_DEG, TALUS_DEG = 58.0, 34.0
"""Slope from which on debris falls from a wall, and at which it comes to rest."""

MOST_COVERED = 0.62
"""Largest share of a wall's height that debris covers."""

TALUS_CELLS = 12
"""Cells of the grid for debris in the height of a wall."""

TO_JOINTS = 0.25
"""Part by which walls leave their smooth lines for those of joints."""

FACE_CELLS = 1.6
"""Width of the faces between blocks, in cells."""

LEDGES = 0.36
"""Part of the rise of a slope that the faces between blocks of a size take up."""

UNEVEN, TILT = 0.1, 0.14
"""Largest shift of a block up or down, in its size, and its largest tilt along an axis: some have
fallen, some stand out."""

WORN_CELLS = 0.6
"""Standard deviation, in cells, of the rounding of edges, without which faces follow the grid."""


def break_rock(
    elevation_m: FloatArray, spacing_m: float, block_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return (rows, cols) heights of a ground whose steep parts are rock broken along joints.

    Args:
        elevation_m: (rows, cols) heights, of a square ground.
        spacing_m: Distance between cells.
        block_m: Spacing of the joints between the largest blocks.
        rng: Draws joints and blocks.
    """
    z = elevation_m.astype(np.float64)
    if block_m < LEAST_CELLS * spacing_m:
        return z
    bare = bareness(z, spacing_m, block_m, randomness.child(rng, "bare"))
    for index, size in enumerate(SIZES):
        edge_m = size * block_m
        if edge_m >= LEAST_CELLS * spacing_m:
            drawn = randomness.child(rng, f"joints/{index}")
            z = _stepped(z, spacing_m, edge_m, bare, drawn)
    worn = smooth(z, WORN_CELLS, truncate=3.0)
    return np.asarray(z + bare * (worn - z))


def bend_to_joints(
    field: FloatArray, spacing_m: float, block_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return (rows, cols) a field whose lines of equal values keep closer to joints.

    Walls that follow such a line have faces, corners and columns.

    Args:
        field: (rows, cols) values, of a square ground.
        spacing_m: Distance between cells.
        block_m: Spacing of the joints.
        rng: Draws them.
    """
    if block_m < LEAST_CELLS * spacing_m:
        return field
    joints = _joints(field.shape, spacing_m, block_m, randomness.child(rng, "walls"))
    blocks, count = joints.blocks(), joints.block_count
    label = blocks.ravel()
    cells = np.bincount(label, minlength=count)
    means = np.bincount(label, field.ravel(), count) / np.maximum(cells, 1)
    moved = np.zeros_like(field)
    for of, share in joints.faces(FACE_CELLS):
        moved += share * np.where(cells[of] > 0, means[of] - field, 0.0)
    return np.asarray(field + TO_JOINTS * moved)


def bareness(
    z: FloatArray, spacing_m: float, patch_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return (rows, cols) from 0, soil or debris, to 1, bare rock: steep ground, in patches."""
    size_px, extent_m = len(z), spacing_m * (len(z) - 1)
    smooth_m = smooth(z, 0.25 * patch_m / spacing_m)
    slope = steepness(smooth_m, spacing_m)
    x, y = grid(extent_m, size_px, 3.0 * patch_m)
    patches = fractal(x, y, rng, octaves=4, gain=0.6).astype(np.float64)
    least, most = (tangent(angle) for angle in BARE_DEG)
    share = (slope - least) / (most - least) + 0.9 * patches
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


class _Joints(NamedTuple):
    """Two sets of joints, of which the second one ends at the first.

    Attributes:
        along: (rows, cols) numbers of joints of the first set up to a place, and the share of the
            way to the next one.
        across: (rows, cols) distances along the second set, in its mean spacing.
        shift: (R,) by which joints of the second set are shifted in each row of blocks.
        ends: (columns + 1,) where these joints are.
        cells: Grid cells across a block of the mean size, along each of both.
    """

    along: FloatArray
    across: FloatArray
    shift: FloatArray
    ends: FloatArray
    cells: tuple[float, float]

    @property
    def columns(self) -> int:
        """Number of blocks in a row, at most."""
        return len(self.ends)

    @property
    def block_count(self) -> int:
        """How many numbers of blocks there are."""
        return len(self.shift) * self.columns

    def blocks(self) -> NDArray[np.intp]:
        """Return the (rows, cols) number of each cell's block."""
        row = np.floor(self.along).astype(np.intp)
        return self._number(row, np.floor(self._across(row)).astype(np.intp))

    def faces(self, width_cells: float) -> Iterator[tuple[NDArray[np.intp], FloatArray]]:
        """Yield the (rows, cols) numbers of blocks, and their shares in each cell, which sum to 1.

        Next to a joint two blocks have shares, so that the face between them is a ramp as wide as
        ``width_cells``: a wall that is no wider than a cell would have the steps of the grid.
        """
        for row, in_row in _two(self.along, width_cells / self.cells[0], len(self.shift)):
            across = self._across(row)
            for column, in_column in _two(across, width_cells / self.cells[1], self.columns):
                yield self._number(row, column), in_row * in_column

    def _across(self, row: NDArray[np.intp]) -> FloatArray:
        """Return what `along` is, of the second set, in (rows, cols) rows of blocks."""
        return np.interp(self.across + self.shift[row], self.ends, np.arange(self.columns))

    def _number(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.asarray(row * self.columns + column)


def _two(
    place: FloatArray, width: float, count: int
) -> Iterator[tuple[NDArray[np.intp], FloatArray]]:
    """Yield the (rows, cols) cell of a place on an axis, and the next one, with their shares."""
    cell = np.floor(place)
    past = place - cell
    is_upper = past > 0.5
    edge = np.where(is_upper, 1.0 - past, past)
    share = np.maximum(0.5 - edge / width, 0.0)
    yield cell.astype(np.intp), 1.0 - share
    beside = np.clip(np.where(is_upper, cell + 1.0, cell - 1.0), 0.0, count - 1.0)
    yield beside.astype(np.intp), share


def _joints(
    shape: tuple[int, ...], spacing_m: float, edge_m: float, rng: np.random.Generator
) -> _Joints:
    size_px, extent_m = shape[0], spacing_m * (shape[0] - 1)
    x, y = grid(extent_m, size_px, 1.0)
    u, v = grid(extent_m, size_px, BEND_BLOCKS * edge_m)
    bends = [BEND * fractal(u, v, rng, octaves=2).astype(np.float64) for _ in range(2)]
    east, north = draw_direction(rng)
    # The second set stands oblique to the first one, and its joints are closer.
    along = (x * east + y * north) / edge_m + bends[0]
    across = (y * (east - 0.3 * north) - x * (north + 0.3 * east)) / (0.7 * edge_m) + bends[1]
    along -= along.min()
    ends = _draw_ends(float(along.max()), rng)
    along = np.interp(along, ends, np.arange(len(ends)))
    across -= across.min()
    shift = SHIFTS * rng.random(int(along.max()) + 1)
    ends = _draw_ends(float(across.max()) + SHIFTS, rng)
    cells = edge_m / spacing_m
    return _Joints(along, across, shift, ends, (cells, 0.7 * cells))


def _draw_ends(length: float, rng: np.random.Generator) -> FloatArray:
    """Return (E,) places of joints from 0 to beyond a length, some close, some far apart."""
    least, more = GAPS
    gaps = least + more * rng.random(int(length / least) + 2) ** 2
    ends = np.concatenate(([0.0], np.cumsum(gaps)))
    return ends[: int(np.searchsorted(ends, length)) + 2]


def _stepped(
    z: FloatArray, spacing_m: float, edge_m: float, bare: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the ground with blocks of a size that lie flatter than the slope, with faces between.

    A block is bare as a whole, or not at all.
    """
    joints = _joints(z.shape, spacing_m, edge_m, rng)
    blocks, count = joints.blocks(), joints.block_count
    shifts = rng.uniform(-1.0, 1.0, (count, 3)) * (UNEVEN * edge_m, TILT, TILT)
    label = blocks.ravel()
    cells = np.maximum(np.bincount(label, minlength=count), 1)
    rows, cols = np.indices(z.shape, np.float64)
    mean_m, mean_col, mean_row, mean_bare = (
        np.bincount(label, each.ravel(), count) / cells for each in (z, cols, rows, bare)
    )
    stands_out = np.clip(3.0 * mean_bare - 0.5, 0.0, 1.0)
    # Of each block, the plane: its height at the origin, and what the ground counts in it.
    rise = spacing_m * stands_out[:, None] * shifts[:, 1:]
    level_m = stands_out * (LEDGES * mean_m + shifts[:, 0])
    level_m -= rise[:, 0] * mean_col + rise[:, 1] * mean_row
    stepped_m = np.zeros_like(z)
    for of, share in joints.faces(FACE_CELLS):
        plane_m = level_m[of] + rise[:, 0][of] * cols + rise[:, 1][of] * rows
        stepped_m += share * (z * (1.0 - LEDGES * stands_out)[of] + plane_m)
    return stepped_m


def lay_talus(
    elevation_m: FloatArray, spacing_m: float, size_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return (rows, cols) heights of a ground with cones of debris at the feet of its walls.

    Cones reach up a share of the wall that differs from place to place, and fall away from it at
    the angle of repose.

    Args:
        elevation_m: (rows, cols) heights, of a square ground.
        spacing_m: Distance between cells.
        size_m: Height of walls, about: what is looked for around each place.
        rng: Draws where cones are.
    """
    if size_m < TALUS_CELLS / 2 * spacing_m:
        return elevation_m.astype(np.float64)
    rng = randomness.child(rng, "talus")
    step = max(1, round(size_m / (TALUS_CELLS * spacing_m)))
    z = elevation_m[::step, ::step].astype(np.float64)
    cell_m = step * spacing_m
    around = 2 * max(1, round(0.5 * size_m / cell_m)) + 1
    low_m = scipy.ndimage.minimum_filter(z, around, mode="nearest")
    high_m = scipy.ndimage.maximum_filter(z, around, mode="nearest")
    x, y = grid(cell_m * (len(z) - 1), len(z), 0.7 * size_m)
    fed = np.clip(0.5 + 0.8 * fractal(x, y, rng, octaves=3).astype(np.float64), 0.0, 1.0)
    up = np.gradient(z, cell_m)
    is_wall = up[0] ** 2 + up[1] ** 2 > tangent(WALL_DEG) ** 2
    top_m = np.where(is_wall, low_m + MOST_COVERED * fed * (high_m - low_m), -np.inf)
    fall_m = cell_m * tangent(TALUS_DEG)
    talus_m = -bound_rises(-top_m, (fall_m, DIAGONAL * fall_m), 2 * TALUS_CELLS)
    raised_m = np.maximum(talus_m - z, 0.0)
    # Debris thins out into the ground instead of ending in a line.
    raised_m = scipy.ndimage.gaussian_filter(raised_m, 1.0, mode="nearest")
    at = np.arange(len(elevation_m)) / step
    places = np.meshgrid(at, at, indexing="ij")
    fine_m = scipy.ndimage.map_coordinates(raised_m, places, order=1, mode="nearest")
    return np.asarray(elevation_m + fine_m)
