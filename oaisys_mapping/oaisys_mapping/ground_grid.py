"""The ground around a place as a grid of cells: heights, classes, where a rover can drive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray, ShortRepr

_LEAST_POINTS = 3
"""Heights in a window through which there is a plane."""


@dataclass(frozen=True)
class GridPlace:
    """Where a grid of square cells is.

    Attributes:
        min_xy_m: Its corner with the least x and y, in ``map``.
        cell_m: Edge of a cell.
        count: Cells along x, and along y.
    """

    min_xy_m: tuple[float, float]
    cell_m: float
    count: int

    @classmethod
    def around(cls, xy_m: tuple[float, float], length_m: float, cell_m: float) -> GridPlace:
        """Return the grid with a place in its middle cell.

        Its corners are at multiples of a cell's edge, so that the cells of all grids coincide.

        Args:
            xy_m: The place, in ``map``.
            length_m: Edge of the grid, at least.
            cell_m: Edge of a cell.
        """
        count = max(int(np.ceil(round(length_m / cell_m, 6))), 1)
        x, y = (float(np.round(each / cell_m - count / 2) * cell_m) for each in xy_m)
        return cls((x, y), cell_m, count)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Least x and y, and largest x and y."""
        (x, y), length_m = self.min_xy_m, self.count * self.cell_m
        return x, y, x + length_m, y + length_m

    def centres_m(self) -> FloatArray:
        """Return the (count, count, 2) x and y of the cells' centres; rows are along y."""
        steps_m = (np.arange(self.count) + 0.5) * self.cell_m
        x_m, y_m = np.meshgrid(self.min_xy_m[0] + steps_m, self.min_xy_m[1] + steps_m)
        return np.stack((x_m, y_m), axis=-1)


@dataclass(frozen=True, repr=False)
class GroundGrid(ShortRepr):
    """Heights and classes in the cells of a grid: row 0 at the least y, column 0 at the least x.

    Attributes:
        place: Where it is.
        elevation_m: (count, count) float32 heights in ``map``; NaN: unknown.
        class_ids: (count, count) labels of that surface, 0: unlabelled; None: unknown.
    """

    place: GridPlace
    elevation_m: NDArray[np.float32]
    class_ids: NDArray[np.uint16] | None = None


@dataclass(frozen=True)
class Rover:
    """What a rover can drive over.

    Attributes:
        clearance_m: Space below it: what is that much higher than the ground around it stops it.
        max_slope_rad: Steepest ground.
        radius_m: Of the circle around a cell that must be passable.
    """

    clearance_m: float
    max_slope_rad: float
    radius_m: float


def ground_layers(grid: GroundGrid, rover: Rover) -> dict[str, NDArray[np.float32]]:
    """Return the layers of a grid by name, each (count, count); NaN: unknown.

    They are ``elevation`` in metres; ``slope`` in radians and ``roughness`` in metres, of the plane
    that fits best within the rover's radius, and the standard deviation from it; ``step`` in
    metres, the largest height above that plane; ``class``; and ``traversability``, from 1 (level
    and smooth) to 0 (as steep or as rough as the rover must not go).
    """
    slope_rad, roughness_m, step_m = _fit_planes(grid, rover.radius_m)
    by_slope = 1.0 - slope_rad / rover.max_slope_rad
    by_step = 1.0 - step_m / rover.clearance_m
    layers = {
        "elevation": grid.elevation_m,
        "slope": slope_rad,
        "roughness": roughness_m,
        "step": step_m,
        "traversability": np.clip(np.minimum(by_slope, by_step), 0.0, 1.0),
    }
    if grid.class_ids is not None:
        known = np.isfinite(grid.elevation_m)
        layers["class"] = np.where(known, grid.class_ids.astype(np.float32), np.nan)
    return {name: np.asarray(layer, np.float32) for name, layer in layers.items()}


def _fit_planes(grid: GroundGrid, radius_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return slope, roughness and step of the plane around each cell, see `ground_layers`."""
    cell_m = grid.place.cell_m
    cells = max(round(radius_m / cell_m), 1)
    middle_m = float(np.nanmean(grid.elevation_m)) if np.isfinite(grid.elevation_m).any() else 0.0
    heights_m = grid.elevation_m.astype(np.float64) - middle_m  # small, for the sums' digits
    moments = np.zeros((6, *heights_m.shape))
    sums = np.zeros((3, *heights_m.shape))
    for x_m, y_m, z_m in _shifted(heights_m, cells, cell_m):
        is_known = np.isfinite(z_m)
        powers = (1.0, x_m, y_m, x_m * x_m, x_m * y_m, y_m * y_m)
        moments += np.array(powers)[:, None, None] * is_known
        sums += np.array((1.0, x_m, y_m))[:, None, None] * np.nan_to_num(z_m)
    planes = _solve(moments, sums)
    squares, step_m = np.zeros(heights_m.shape), np.zeros(heights_m.shape)
    for x_m, y_m, z_m in _shifted(heights_m, cells, cell_m):
        above_m = z_m - (planes[0] + planes[1] * x_m + planes[2] * y_m)
        squares += np.nan_to_num(above_m) ** 2
        step_m = np.fmax(step_m, above_m)
    unknown = ~np.isfinite(heights_m) | ~np.isfinite(planes[0])
    slope_rad = np.arctan(np.hypot(planes[1], planes[2]))
    roughness_m = np.sqrt(squares / np.maximum(moments[0], 1.0))
    found = (np.where(unknown, np.nan, each) for each in (slope_rad, roughness_m, step_m))
    return tuple(found)  # type: ignore[return-value]


def _shifted(
    heights_m: FloatArray, cells: int, cell_m: float
) -> Iterator[tuple[float, float, FloatArray]]:
    """Yield the heights of each neighbour within a circle, and how far it is along x and y."""
    rows, columns = heights_m.shape
    padded = np.pad(heights_m, cells, constant_values=np.nan)
    for row, column in product(range(-cells, cells + 1), repeat=2):
        if row * row + column * column <= (cells + 0.5) ** 2:
            part = padded[cells + row :, cells + column :][:rows, :columns]
            yield column * cell_m, row * cell_m, part


def _solve(moments: FloatArray, sums: FloatArray) -> FloatArray:
    """Return (3, H, W) planes c + a x + b y by least squares; NaN where there is none."""
    n, x, y, xx, xy, yy = moments
    normal = np.stack((n, x, y, x, xx, xy, y, xy, yy), axis=-1).reshape(*n.shape, 3, 3)
    scale = np.maximum(xx + yy, 1e-12)
    is_plane = (n >= _LEAST_POINTS) & (np.abs(np.linalg.det(normal)) > 1e-6 * n * scale**2)
    normal[~is_plane] = np.eye(3)
    found = np.linalg.solve(normal, np.moveaxis(sums, 0, -1)[..., None])[..., 0]
    found[~is_plane] = np.nan
    return np.moveaxis(found, -1, 0)


def grid_of_points(
    place: GridPlace, points_m: FloatArray, class_ids: NDArray[np.uint16] | None
) -> GroundGrid:
    """Return the grid of a surface's points: in each cell the mean of the topmost ones.

    Args:
        place: Where the grid is.
        points_m: (N, 3), in ``map``.
        class_ids: (N,) their labels; None: unknown. A cell gets that of its highest point.
    """
    count = place.count
    cells = np.floor((points_m[:, :2] - place.min_xy_m) / place.cell_m).astype(np.int64)
    is_inside = ((cells >= 0) & (cells < count)).all(axis=1)
    cell, z_m = cells[is_inside, 1] * count + cells[is_inside, 0], points_m[is_inside, 2]
    highest_m = np.full(count * count, -np.inf)
    np.maximum.at(highest_m, cell, z_m)
    # A cell may also have ground below an overhang; a slope is not cut, as its heights differ less.
    is_top = z_m >= highest_m[cell] - place.cell_m
    number = np.bincount(cell[is_top], minlength=count * count)
    total_m = np.bincount(cell[is_top], z_m[is_top], minlength=count * count)
    elevation_m = np.where(number > 0, total_m / np.maximum(number, 1), np.nan)
    classes = None
    if class_ids is not None:
        classes = np.zeros(count * count, np.uint16)
        is_highest = z_m == highest_m[cell]
        classes[cell[is_highest]] = class_ids[is_inside][is_highest]
        classes = classes.reshape(count, count)
    return GroundGrid(place, elevation_m.reshape(count, count).astype(np.float32), classes)
