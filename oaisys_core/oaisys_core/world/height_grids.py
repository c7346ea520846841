"""Heights on a regular grid: its layout, its size limit, and how it is filled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import ceil, isfinite

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, HeightGrid, HeightQuery, Progress, ProgressCallback

MAX_CELLS = 4096 * 4096
"""Largest number of cells of a grid: 128 MiB of heights."""

BLOCK_CELLS = 1 << 18
"""Number of cells that are looked up at once."""

Extent = tuple[float, float, float, float]
"""(min_x, min_y, max_x, max_y) in ``map``, metres."""


def grid_shape(resolution_m: float, extent_m: Extent) -> tuple[int, int]:
    """Return the rows and columns of the cells that cover an extent.

    Raises:
        InvalidInputError: The resolution or the extent is invalid, or the grid would have more than
            `MAX_CELLS` cells.
    """
    if not (isfinite(resolution_m) and resolution_m > 0):
        raise InvalidInputError("resolution_m", resolution_m, "a positive number of metres")
    x0, y0, x1, y1 = extent_m
    if not (all(map(isfinite, extent_m)) and x0 < x1 and y0 < y1):
        raise InvalidInputError("extent_m", extent_m, "finite min_x, min_y < max_x, max_y")
    # Compare before rounding: the quotients may be too large for integers.
    columns, rows = ((high - low) / resolution_m for low, high in ((x0, x1), (y0, y1)))
    if not columns * rows <= MAX_CELLS or max(columns, rows) > MAX_CELLS:
        least_m = ((x1 - x0) * (y1 - y0) / MAX_CELLS) ** 0.5
        expected = f"at most {MAX_CELLS} cells: about {least_m:.3g} m or more for this extent"
        raise InvalidInputError("resolution_m", resolution_m, expected)
    return max(1, ceil(rows - 1e-6)), max(1, ceil(columns - 1e-6))


def height_grid(
    resolution_m: float,
    extent_m: Extent,
    query: Callable[[FloatArray], HeightQuery],
    progress: ProgressCallback,
) -> HeightGrid:
    """Return the heights at the centres of the cells of an extent.

    Args:
        resolution_m: Edge of a cell.
        extent_m: The first cell starts at its (min_x, min_y); the last cells may reach beyond it.
        query: Returns the heights under (N, 3) points.
        progress: Receives the progress; may raise `CancelledError`.

    Raises:
        InvalidInputError: See `grid_shape`.
    """
    rows, columns = grid_shape(resolution_m, extent_m)
    origin_m = (extent_m[0] + resolution_m / 2, extent_m[1] + resolution_m / 2)
    ground_m = np.empty((rows, columns), np.float32)
    surface_m = np.empty((rows, columns), np.float32)
    x_m = origin_m[0] + resolution_m * np.arange(columns)
    for first, last in _blocks(rows, columns):
        y_m = origin_m[1] + resolution_m * np.arange(first, last)
        points = np.zeros((last - first, columns, 3))
        points[..., 0], points[..., 1] = x_m, y_m[:, None]
        found = query(points.reshape(-1, 3))
        ground_m[first:last] = found.ground_height_m.reshape(-1, columns)
        surface_m[first:last] = found.surface_height_m.reshape(-1, columns)
        progress(Progress("heights", last / rows))
    return HeightGrid(ground_m, surface_m, origin_m, resolution_m)


def _blocks(rows: int, columns: int) -> Iterator[tuple[int, int]]:
    step = max(1, BLOCK_CELLS // columns)
    for first in range(0, rows, step):
        yield first, min(first + step, rows)
