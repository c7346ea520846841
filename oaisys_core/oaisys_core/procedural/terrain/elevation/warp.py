"""Elevation models warped to true distances around their middle."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, pi, radians, sin
from typing import TYPE_CHECKING

import numpy as np
import scipy

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.references import Reference, coordinates
from oaisys_core.types import FloatArray, Georeference

if TYPE_CHECKING:
    from affine import Affine
    from pyproj import CRS

EDGE_POINTS = 101
"""Points along an edge of the image, to find the largest rectangle inside of it."""

CONTROL_POINTS = 65
"""Points along each axis of the grid that are projected."""

PIXEL_TOLERANCE = 0.25
"""Share of a pixel by which a step may exceed a whole number of pixels before heights are smoothed
over one more: pixels differ in size across an image."""

MAX_ANGLE = 0.5
"""Radians on the body from the middle to a corner; a map of more is no ground to stand on."""


class LocalGrid:
    """A grid in true distances from the middle of an image, which lies in the image.

    The projection is azimuthal equidistant around the middle.
    """

    def __init__(
        self,
        reference: Reference,
        transform: Affine,
        shape: tuple[int, ...],
        up_deg: float,
        field: str,
    ) -> None:
        """Find the largest rectangle around the middle of an image that lies in it.

        Args:
            reference: Of the image's x and y.
            transform: From column and row to x and y.
            shape: Rows and columns.
            up_deg: Azimuth of the grid's +y in the middle.
            field: Name of the configuration field in errors.

        Raises:
            InvalidInputError: The image spans too much of the body.
        """
        from pyproj import Transformer

        self._reference, self._transform = reference, transform
        self._up = radians(up_deg)
        rows, cols = shape
        middle = coordinates(transform, np.asarray(cols / 2), np.asarray(rows / 2))
        lon, lat = reference.lon_lat_deg(*middle)
        self._system = _equidistant(reference, float(lon), float(lat))
        self._to_system = Transformer.from_crs(reference.geodetic, self._system, always_xy=True)
        self.half_m = self._half_extent_m(rows, cols, field)

    @property
    def georeference(self) -> Georeference:
        """Where the grid lies."""
        right, up = cos(self._up), sin(self._up)
        return Georeference(self._system.to_wkt(), (right, up, 0.0, -up, right, 0.0), 0.0)

    def warp(self, height_m: FloatArray, step_m: float, counts: tuple[int, int]) -> FloatArray:
        """Return heights on (rows, cols) points, row 0 in the south, by cubic splines.

        GDAL is not asked: it may have another version of PROJ, and they differ in kilometres for
        some projections (equidistant cylindrical ones of ellipsoids, from PROJ 9.8 on).

        Args:
            height_m: Heights of the image, as in the file.
            step_m: Distance between the points.
            counts: Columns and rows, centred on the image's middle.
        """
        rows, cols = self._places_px(step_m, counts, height_m.shape)
        steps = (np.hypot(*np.gradient(each)).max() for each in (rows, cols))
        reduced = [max(1, ceil(step - PIXEL_TOLERANCE)) for step in steps]
        if max(reduced) > 1:
            # Smooth first, because finer relief would alias.
            odd = [2 * (n // 2) + 1 for n in reduced]
            height_m = scipy.ndimage.uniform_filter(height_m, odd, mode="mirror")
        return np.asarray(spline_through(indices(height_m.shape), height_m).ev(rows, cols))

    def _places_px(
        self, step_m: float, counts: tuple[int, int], shape: tuple[int, ...]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the (rows, cols) rows and columns of the points in the image.

        Few of them are projected: the others follow from splines.
        """
        along = [np.linspace(0, n - 1, min(n, CONTROL_POINTS)) for n in counts]
        u, v = ((each - (n - 1) / 2) * step_m for each, n in zip(along, counts, strict=True))
        v, u = np.meshgrid(v, u, indexing="ij")
        east = u * cos(self._up) + v * sin(self._up)
        north = v * cos(self._up) - u * sin(self._up)
        lon, lat = self._to_system.transform(east, north, direction="INVERSE")
        x, y = self._reference.x_y(lon, lat)
        if self._reference.horizontal.is_geographic:  # from 0 to 360°, or from -180 to 180
            whole_turn = 2 * pi / self._reference.unit_m
            half_rows, half_cols = (np.asarray(n / 2) for n in shape)
            middle_x, _ = coordinates(self._transform, half_cols, half_rows)
            x = x + whole_turn * np.round((middle_x - x) / whole_turn)
        inverse = ~self._transform
        col, row = coordinates(inverse, x, y)
        rows, cols = (
            spline_through(along[::-1], each - 0.5)(*indices(counts[::-1])) for each in (row, col)
        )
        return np.asarray(rows), np.asarray(cols)

    def _half_extent_m(self, rows: int, cols: int, field: str) -> tuple[float, float]:
        """Return half the width and half the height of the rectangle."""
        along = np.linspace(0, 1, EDGE_POINTS)
        right, down = 0.5 + along * (cols - 1), 0.5 + along * (rows - 1)
        sides = []
        for col, row in (
            (np.full_like(down, 0.5), down),
            (np.full_like(down, cols - 0.5), down),
            (right, np.full_like(right, 0.5)),
            (right, np.full_like(right, rows - 0.5)),
        ):
            place = self._reference.lon_lat_deg(*coordinates(self._transform, col, row))
            east, north = self._to_system.transform(*place)
            u = east * cos(self._up) - north * sin(self._up)
            v = east * sin(self._up) + north * cos(self._up)
            sides.append(np.stack([u, v]))
        radius_m = float(self._reference.geod.a)
        farthest_m = max(float(np.hypot(*side).max()) for side in sides)
        if not farthest_m <= MAX_ANGLE * radius_m:  # not finite either
            found = f"{farthest_m / 1000:.0f} km from its middle to a corner"
            expected = f"at most {MAX_ANGLE * radius_m / 1000:.0f} km: cut a part out of the file"
            raise InvalidInputError(f"{field}.file", found, expected)
        return (
            min(float(np.abs(side[0]).min()) for side in sides[:2]),
            min(float(np.abs(side[1]).min()) for side in sides[2:]),
        )


def _equidistant(reference: Reference, lon_deg: float, lat_deg: float) -> CRS:
    """Return a projection in metres, true in distances and directions from a place."""
    from pyproj.crs import ProjectedCRS
    from pyproj.crs.coordinate_operation import AzimuthalEquidistantConversion

    conversion = AzimuthalEquidistantConversion(lat_deg, lon_deg)
    return ProjectedCRS(conversion, geodetic_crs=reference.geodetic)


def indices(counts: tuple[int, ...]) -> list[FloatArray]:
    """Return 0, 1, ... along each axis of an image."""
    return [np.arange(n, dtype=np.float64) for n in counts]


def spline_through(
    axes: Sequence[FloatArray], values: FloatArray
) -> scipy.interpolate.RectBivariateSpline:
    """Return a spline through (R, C) values at rows and columns.

    It is cubic if there are enough, so that a coarse file shows no facets.
    """
    kx, ky = (min(3, len(axis) - 1) for axis in axes)
    return scipy.interpolate.RectBivariateSpline(*axes, values, kx=kx, ky=ky)
