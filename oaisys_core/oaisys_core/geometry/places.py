"""Longitude, latitude and elevation of points in ``map``, and back, by PROJ."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_core.types.georeference import Georeference

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

NORTH_STEP_M = 1.0
"""Length of the step by which the direction of +y is found."""

AXIS_STEP_M = 50.0
"""The same, where directions are compared in the body's own axes: longer because of rounding."""

MOST_LON_DEG = 360.0
"""Longitudes beyond a whole turn are none that anybody means."""

SAME_PLACE_DEG = 1e-6
"""A place that PROJ turns into a point and back is the same within 0.1 m."""

SAME_PLACE = 1e-6
"""The same for points, as a share of their largest coordinate, and in units of the system."""

LON_STEP_DEG = 1e-3
"""Step in which the width of a whole turn is measured."""


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


def places_of(georeference: Georeference, points_m: ArrayLike) -> FloatArray:
    """Return what `lon_lat_height` does, for points that may be anywhere.

    Raises:
        InvalidInputError: A point is not in the area of the ground's reference system, beyond which
            PROJ returns infinite longitudes, or those of other points.
    """
    points = np.asarray(points_m, np.float64).reshape(-1, 3)
    found = lon_lat_height(georeference, points)
    a, b, c, d, e, f = georeference.map_to_system
    there = np.array(((a, b), (d, e))) @ points[:, :2].T + np.array(((c,), (f,)))
    with np.errstate(all="ignore"):
        is_wrong = ~(_returns(georeference.wkt, there, found) & _is_on_globe(found))
    if is_wrong.any():
        expected = "a point in the area of the stage's reference system"
        raise InvalidInputError("point", points[is_wrong][0].tolist(), expected)
    return found


def _is_on_globe(places: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) whether (N, 3) places have longitudes and latitudes within their bounds."""
    bounds = (MOST_LON_DEG, 90.0)
    return np.asarray((np.abs(places[:, :2]) <= bounds).all(axis=1))


def _returns(wkt: str, there: FloatArray, places: FloatArray) -> NDArray[np.bool_]:
    """Return (N,) whether (N, 3) places lie at (2, N) coordinates of a system, or a turn further.

    Only where x grows evenly with the longitude are there points beyond the longitude of 180.
    """
    lon, lat = places[:, 0], places[:, 1]
    back = np.array(_transformer(wkt).transform(lon, lat, direction="INVERSE"))
    near = (lon - np.copysign(LON_STEP_DEG, lon), lat)
    step = np.abs(back[0] - _transformer(wkt).transform(*near, direction="INVERSE")[0])
    turns = np.rint((there[0] - back[0]) * LON_STEP_DEG / step / 360.0)
    turns = np.clip(np.nan_to_num(turns), -1.0, 1.0)
    miss = there - back
    miss[0] -= turns * step / LON_STEP_DEG * 360.0
    most = SAME_PLACE * (1.0 + np.abs(there).max(axis=0))
    return np.asarray((np.abs(miss) <= most).all(axis=0))


def points_in_map(georeference: Georeference, places: ArrayLike) -> FloatArray:
    """Return the (N, 3) points in ``map`` of places as `lon_lat_height` returns them.

    Raises:
        InvalidInputError: A place is none in the ground's reference system.
    """
    given = np.asarray(places, np.float64).reshape(-1, 3)
    to_system = _transformer(georeference.wkt)
    x, y = to_system.transform(given[:, 0], given[:, 1], direction="INVERSE")
    outside = ~(np.isfinite(x) & np.isfinite(y))
    lon, lat = to_system.transform(x, y)
    # Far from its area a projection puts places where others are.
    with np.errstate(invalid="ignore"):
        turn_deg = (lon - given[:, 0] + 180.0) % 360.0 - 180.0
        away_deg = np.hypot(turn_deg * np.cos(np.radians(given[:, 1])), lat - given[:, 1])
        outside |= ~(away_deg < SAME_PLACE_DEG)
    if outside.any():
        received = "{:.9g}, {:.9g}".format(*given[outside][0])
        expected = "longitude and latitude in the area of the stage's reference system"
        raise InvalidInputError("place", received, expected)
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
