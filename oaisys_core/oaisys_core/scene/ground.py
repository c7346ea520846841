"""The ground of a stage: what is asked of it, and the regular grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import (
    FloatArray,
    ShortRepr,
)


class Ground(Protocol):
    """The ground of a stage: one surface for rendering, labels and height queries."""

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""

    @property
    def spacing_m(self) -> float:
        """Typical distance between neighbouring vertices."""

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (V, 3) float32 vertices in ``map``."""

    def triangles(self) -> NDArray[np.int32]:
        """Return (T, 3) int32 indices, counter-clockwise from above."""

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the topmost surface at (N, 2) points; NaN outside the ground."""


@dataclass(frozen=True, repr=False)
class HeightField(ShortRepr):
    """The ground as a regular grid of elevations, triangulated along one diagonal.

    The triangulation is the surface: all backends, labels and queries use it.

    Attributes:
        elevation_m: (rows, cols) float32; row i lies at y = origin + i * spacing, column j at
            x = origin + j * spacing.
        origin_xy_m: (x, y) of elevation[0, 0].
        spacing_m: Distance between neighbouring grid points.
    """

    elevation_m: NDArray[np.float32]
    origin_xy_m: tuple[float, float]
    spacing_m: float

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""
        rows, cols = self.elevation_m.shape
        x0, y0 = self.origin_xy_m
        return (x0, y0, x0 + (cols - 1) * self.spacing_m, y0 + (rows - 1) * self.spacing_m)

    def grid_m(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the (rows,) float32 y and (cols,) x of vertices."""
        rows, cols = self.elevation_m.shape
        x0, y0, x1, y1 = self.extent_m
        y_m, x_m = np.linspace(y0, y1, rows), np.linspace(x0, x1, cols)
        return y_m.astype(np.float32), x_m.astype(np.float32)

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (rows * cols, 3) float32 vertices, row by row."""
        y_m, x_m = self.grid_m()
        vertices = np.empty((*self.elevation_m.shape, 3), dtype=np.float32)
        vertices[..., 0] = x_m[None, :]
        vertices[..., 1] = y_m[:, None]
        vertices[..., 2] = self.elevation_m
        return vertices.reshape(-1, 3)

    def slopes(self) -> NDArray[np.float32]:
        """Return (rows, columns, 2) float32 slopes along x and y at the points, by those beside."""
        elevation_m = self.elevation_m.astype(np.float32, copy=False)
        along_y, along_x = np.gradient(elevation_m, np.float32(self.spacing_m))
        return np.stack((along_x, along_y), axis=-1)

    def triangles(self) -> NDArray[np.int32]:
        """Return (2 * (rows - 1) * (cols - 1), 3) int32 indices, counter-clockwise from above.

        Each cell is cut from its (row, col) corner to its (row + 1, col + 1) corner; the lower
        triangle (towards +x) comes first.
        """
        rows, cols = self.elevation_m.shape
        index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
        a, b = index[:-1, :-1], index[:-1, 1:]
        c, d = index[1:, 1:], index[1:, :-1]
        corners = np.empty((rows - 1, cols - 1, 6), dtype=np.int32)
        for place, corner in enumerate((a, b, c, a, c, d)):
            corners[..., place] = corner
        return corners.reshape(-1, 3)

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) elevations of the triangulated surface at (N, 2) points; NaN outside it."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        rows, cols = self.elevation_m.shape
        with np.errstate(over="ignore"):  # infinitely far away is outside, too
            x, y = ((xy - np.asarray(self.origin_xy_m)) / self.spacing_m).T.copy()
        inside = (x >= 0) & (x <= cols - 1) & (y >= 0) & (y <= rows - 1)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        col, row = np.minimum(np.floor(x), cols - 2), np.minimum(np.floor(y), rows - 2)
        s, t = x - col, y - row
        corner = row.astype(np.intp) * cols + col.astype(np.intp)
        z00, z10, z01, z11 = (
            self.elevation_m.take(corner + after).astype(np.float64)
            for after in (0, 1, cols, cols + 1)
        )
        lower = z00 + s * (z10 - z00) + t * (z11 - z10)
        upper = z00 + t * (z01 - z00) + s * (z11 - z01)
        return np.where(inside, np.where(s >= t, lower, upper), np.nan)
