"""Elevation models warped to true distances around their middle."""

from __future__ import annotations

from math import cos, radians, sin
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.references import Reference, coordinates
from oaisys_core.types import FloatArray, Georeference

if TYPE_CHECKING:
    from affine import Affine
    from pyproj import CRS

EDGE_POINTS = 101
"""Points along an edge of the image, to find the largest rectangle inside of it."""

TOLERANCE_PX = 0.01
"""Largest error of a place in the image, with which GDAL may go on without PROJ."""

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
        self._reference, self._transform = reference, transform
        self._up = radians(up_deg)
        rows, cols = shape
        middle = coordinates(transform, np.asarray(cols / 2), np.asarray(rows / 2))
        lon, lat = reference.lon_lat_deg(*middle)
        self._system = _equidistant(reference, float(lon), float(lat))
        self.half_m = self._half_extent_m(rows, cols, field)

    @property
    def georeference(self) -> Georeference:
        """Where the grid lies."""
        right, up = cos(self._up), sin(self._up)
        return Georeference(self._system.to_wkt(), (right, up, 0.0, -up, right, 0.0), 0.0)

    def warp(self, height_m: FloatArray, step_m: float, counts: tuple[int, int]) -> FloatArray:
        """Return heights on (rows, cols) points, row 0 in the south.

        Args:
            height_m: Heights of the image, as in the file.
            step_m: Distance between the points.
            counts: Columns and rows, centred on the image's middle.
        """
        import rasterio.crs
        from affine import Affine
        from rasterio.warp import Resampling, reproject

        crs, transform = self._reference.horizontal, self._transform
        if self._reference.is_to_the_west:
            t = transform
            crs, transform = self._reference.geodetic, Affine(-t.a, -t.b, -t.c, t.d, t.e, t.f)
        result = np.full(counts[::-1], np.nan)
        reproject(
            np.ascontiguousarray(height_m),
            result,
            src_transform=transform,
            src_crs=rasterio.crs.CRS.from_wkt(crs.to_wkt()),
            dst_transform=self._grid_transform(step_m, counts),
            dst_crs=rasterio.crs.CRS.from_wkt(self._system.to_wkt()),
            dst_nodata=np.nan,
            resampling=Resampling.cubic,
            tolerance=TOLERANCE_PX,
        )
        return result[::-1]

    def _grid_transform(self, step_m: float, counts: tuple[int, int]) -> Affine:
        from affine import Affine

        right = (step_m * cos(self._up), -step_m * sin(self._up))
        down = (-step_m * sin(self._up), -step_m * cos(self._up))
        east, north = (-counts[0] / 2 * right[n] - counts[1] / 2 * down[n] for n in (0, 1))
        return Affine(right[0], down[0], east, right[1], down[1], north)

    def _half_extent_m(self, rows: int, cols: int, field: str) -> tuple[float, float]:
        """Return half the width and half the height of the rectangle."""
        from pyproj import Transformer

        to_system = Transformer.from_crs(self._reference.geodetic, self._system, always_xy=True)
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
            east, north = to_system.transform(*place)
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
