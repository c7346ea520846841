"""Longitude, latitude and elevation of points in ``map``, and back, by PROJ."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_core.types.georeference import Georeference

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

NORTH_STEP_M = 1.0
"""Length of the step by which the direction of +y is found."""

AXIS_STEP_M = 50.0
"""The same, where directions are compared in the body's own axes: longer because of rounding."""


def lon_lat_height(georeference: Georeference, points_m: ArrayLike) -> FloatArray:
    """Return (N, 3) longitudes and latitudes in degrees, and elevations in metres.

    Longitudes are positive to the east. The datum is that of the ground's reference system, and
    elevations are those of the elevation model.

    Args:
        georeference: Of the ground.
        points_m: (N, 3) in ``map``.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    a, b, c, d, e, f = georeference.map_to_system
    x = a * points[:, 0] + b * points[:, 1] + c
    y = d * points[:, 0] + e * points[:, 1] + f
    lon, lat = _transformer(georeference.wkt).transform(x, y)
    return np.stack((lon, lat, points[:, 2] - georeference.height_offset_m), axis=-1)


def points_in_map(georeference: Georeference, places: ArrayLike) -> FloatArray:
    """Return the (N, 3) points in ``map`` of places as `lon_lat_height` returns them.

    Raises:
        InvalidInputError: A place is none in the ground's reference system.
    """
    given = np.asarray(places, np.float64).reshape(-1, 3)
    to_system = _transformer(georeference.wkt)
    x, y = to_system.transform(given[:, 0], given[:, 1], direction="INVERSE")
    outside = ~(np.isfinite(x) & np.isfinite(y))
    if outside.any():
        lon, lat, _ = given[outside][0]
        expected = "longitude and latitude in the area of the stage's reference system"
        raise InvalidInputError("place", f"{lon:.9g}, {lat:.9g}", expected)
    a, b, c, d, e, f = georeference.map_to_system
    points = np.linalg.solve(np.array(((a, b), (d, e))), np.stack((x - c, y - f)))
    return np.stack((*points, given[:, 2] + georeference.height_offset_m), axis=-1)


def waypoints_in_map(
    georeference: Georeference | None, waypoints: Sequence[Sequence[float]], field: str
) -> FloatArray:
    """Return the (K, 3) points in ``map`` of waypoints in degrees; z is NaN where none is given.

    Args:
        georeference: Of the ground; None if it is of no place.
        waypoints: Longitude, latitude and perhaps elevation, as `points_in_map` takes them.
        field: Name of the waypoints in errors.

    Raises:
        InvalidInputError: The ground is of no place, or a waypoint is outside its system's area.
    """
    if georeference is None:
        expected = "a stage whose elevation model says where it lies (see `oaisys place info`)"
        raise InvalidInputError(field, waypoints[0], expected)
    given = np.array([(*point, np.nan)[:3] for point in waypoints])
    # PROJ needs no height for a place, and would lose it all for want of one.
    points_m = points_in_map(georeference, np.nan_to_num(given))
    points_m[np.isnan(given[:, 2]), 2] = np.nan
    return points_m


def north_deg(georeference: Georeference) -> float:
    """Return the azimuth of +y at the origin of ``map``: 0 if it points to true north."""
    start, end = lon_lat_height(georeference, ((0, 0, 0), (0, NORTH_STEP_M, 0)))
    geod = system_of(georeference.wkt).get_geod()
    assert geod is not None
    azimuth_deg, _, _ = geod.inv(*start[:2], *end[:2])
    return float(azimuth_deg)


def axes_on_body(georeference: Georeference, flattening: float) -> FloatArray:
    """Return the (3, 3) directions of x, y and up at the origin of ``map`` in the body's own axes.

    These are x to longitude 0 on the equator, z to the north pole.

    Args:
        georeference: Of the ground.
        flattening: Of the body, for a reference system on a sphere, whose latitudes are then angles
            at the body's centre. Ellipsoids of reference systems have their own.
    """
    steps_m = ((0, 0, 0), (0, AXIS_STEP_M, 0), (0, -AXIS_STEP_M, 0))
    lon, lat = np.radians(lon_lat_height(georeference, steps_m)[:, :2]).T
    geod = system_of(georeference.wkt).get_geod()
    assert geod is not None
    if geod.f == 0:
        # From the latitude at the centre to that of the vertical.
        lat = np.arctan2(np.sin(lat), np.cos(lat) * (1 - flattening) ** 2)
    squeeze = (1 - (geod.f or flattening)) ** 2
    normals = np.stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)), -1)
    radius = 1 / np.sqrt(np.cos(lat) ** 2 + squeeze * np.sin(lat) ** 2)
    points = radius[:, None] * normals * (1.0, 1.0, squeeze)
    up = normals[0]
    y = points[1] - points[2]
    y -= (y @ up) * up
    y /= np.linalg.norm(y)
    x = np.cross(y, up)
    return np.stack((x, y, up))


def transform_earth_map(georeference: Georeference) -> FloatArray:
    """Return the (4, 4) transform from ``map`` to the axes of an Earth-centred, Earth-fixed frame.

    Its x leads to longitude 0 on the equator, its z to the north pole (REP-105). The elevation of
    the origin counts as its height above the ellipsoid.
    """
    from pyproj import Transformer

    geod = system_of(georeference.wkt).get_geod()
    assert geod is not None
    to_centre = Transformer.from_pipeline(f"+proj=cart +a={geod.a} +b={geod.b}")
    ((lon_deg, lat_deg, height_m),) = lon_lat_height(georeference, ((0, 0, 0),))
    T = np.eye(4)
    T[:3, :3] = axes_on_body(georeference, geod.f).T
    # Without another declaration the pipeline takes degrees.
    T[:3, 3] = to_centre.transform(lon_deg, lat_deg, height_m)
    return T


@lru_cache(maxsize=16)
def system_of(wkt: str) -> CRS:
    """Return the reference system of a text."""
    from pyproj import CRS

    return CRS.from_wkt(wkt)


@lru_cache(maxsize=16)
def _transformer(wkt: str) -> Transformer:
    from pyproj import Transformer

    system = system_of(wkt)
    geodetic = system.geodetic_crs
    assert geodetic is not None
    return Transformer.from_crs(system, geodetic, always_xy=True)
