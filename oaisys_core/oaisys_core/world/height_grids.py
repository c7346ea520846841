"""Heights on a regular grid: its layout, its size limit, and how it is filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, isfinite

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import MAX_M
from oaisys_core.types import (
    Extent,
    FloatArray,
    HeightGrid,
    HeightQuery,
    Progress,
    ProgressCallback,
)

MAX_CELLS = 4096 * 4096
"""Largest number of cells of a grid: 128 MiB of heights."""

BLOCK_CELLS = 1 << 17
"""Cells that are looked up at once; clients of a server wait for so many of another one."""

Heights = NDArray[np.float32]
HeightLookup = Callable[[FloatArray], HeightQuery]


def grid_shape(resolution_m: float, extent_m: Extent) -> tuple[int, int]:
    """Return the rows and columns of the cells that cover an extent.

    Raises:
        InvalidInputError: The resolution or the extent is invalid, no cell has its centre in the
            extent, or the grid would have more than `MAX_CELLS` cells.
    """
    if not (isfinite(resolution_m) and resolution_m > 0):
        raise InvalidInputError("resolution_m", resolution_m, "a positive number of metres")
    x0, y0, x1, y1 = extent_m
    if not (max(map(abs, extent_m)) <= MAX_M and x0 < x1 and y0 < y1):
        expected = f"finite min_x, min_y < max_x, max_y, from {-MAX_M:g} to {MAX_M:g} m"
        raise InvalidInputError("extent_m", extent_m, expected)
    most_m = 2 * min(x1 - x0, y1 - y0)
    if resolution_m > most_m:
        expected = f"at most {most_m:g} m, so that the centre of a cell is in the extent"
        raise InvalidInputError("resolution_m", resolution_m, expected)
    # Compare before rounding: the quotients may be too large for integers.
    columns, rows = ((high - low) / resolution_m for low, high in ((x0, x1), (y0, y1)))
    if not columns * rows <= MAX_CELLS or max(columns, rows) > MAX_CELLS:
        least_m = ((x1 - x0) * (y1 - y0) / MAX_CELLS) ** 0.5
        expected = f"at most {MAX_CELLS} cells: about {least_m:.3g} m or more for this extent"
        raise InvalidInputError("resolution_m", resolution_m, expected)
    return max(1, ceil(rows - 1e-6)), max(1, ceil(columns - 1e-6))


@dataclass(frozen=True)
class GridPlan:
    """Where the cells of a grid are; they count row by row from the south-west.

    Attributes:
        origin_xy_m: Centre of cell 0, in ``map``.
        spacing_m: Edge of a cell.
    """

    rows: int
    columns: int
    origin_xy_m: tuple[float, float]
    spacing_m: float

    @classmethod
    def of(cls, resolution_m: float, extent_m: Extent) -> GridPlan:
        """Return the plan of the cells that cover an extent.

        Raises:
            InvalidInputError: See `grid_shape`.
        """
        rows, columns = grid_shape(resolution_m, extent_m)
        origin_m = (extent_m[0] + resolution_m / 2, extent_m[1] + resolution_m / 2)
        return cls(rows, columns, origin_m, resolution_m)

    @property
    def cells(self) -> int:
        """Their number."""
        return self.rows * self.columns

    def block(self, first: int) -> range:
        """Return the cells that are looked up together, from a cell on."""
        return range(first, min(first + BLOCK_CELLS, self.cells))

    def heights_m(self, block: range, query: HeightLookup) -> tuple[Heights, Heights]:
        """Return the (N,) heights of ground and topmost surface at the centres of cells."""
        row, column = np.divmod(np.arange(block.start, block.stop), self.columns)
        points_m = np.zeros((len(block), 3))
        points_m[:, 0] = self.origin_xy_m[0] + self.spacing_m * column
        points_m[:, 1] = self.origin_xy_m[1] + self.spacing_m * row
        found = query(points_m)
        ground_m, surface_m = found.ground_height_m, found.surface_height_m
        return ground_m.astype(np.float32), surface_m.astype(np.float32)


def height_grid(plan: GridPlan, query: HeightLookup, progress: ProgressCallback) -> HeightGrid:
    """Return the heights at the centres of all cells.

    Args:
        plan: Where they are.
        query: Returns the heights under (N, 3) points.
        progress: Receives the progress; may raise `CancelledError`.
    """
    ground_m = np.empty(plan.cells, np.float32)
    surface_m = np.empty(plan.cells, np.float32)
    for first in range(0, plan.cells, BLOCK_CELLS):
        block = plan.block(first)
        cells = slice(block.start, block.stop)
        ground_m[cells], surface_m[cells] = plan.heights_m(block, query)
        progress(Progress("heights", block.stop / plan.cells))
    shape = (plan.rows, plan.columns)
    return HeightGrid(
        ground_m.reshape(shape), surface_m.reshape(shape), plan.origin_xy_m, plan.spacing_m
    )
