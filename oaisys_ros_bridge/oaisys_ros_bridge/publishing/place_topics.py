"""Where the rig is on Earth, if the ground says where it lies."""

from __future__ import annotations

from functools import lru_cache
from math import cos, isclose, radians, sin
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped, Vector3
from sensor_msgs.msg import FluidPressure, MagneticField, NavSatFix, NavSatStatus
from std_msgs.msg import Header

from oaisys_core.geometry import places, pose_to_matrix
from oaisys_core.types import FloatArray, Georeference, Pose
from oaisys_ros_bridge.conversions import transform_to_msg
from oaisys_ros_bridge.publishing.publishers import Publishers, has_subscribers
from oaisys_ros_bridge.qos import SENSOR_QOS

if TYPE_CHECKING:
    from pygeomag import GeoMag

EARTH_RADIUS_M = 6_378_137.0
"""Equatorial radius of WGS 84, on which a NavSatFix is by its definition."""

SEA_LEVEL_PA, SEA_LEVEL_K = 101_325.0, 288.15
LAPSE_K_M = 0.0065
"""The air of the International Standard Atmosphere (ISO 2533:1975), up to 11 km."""

EXPONENT = 9.80665 / (287.05287 * LAPSE_K_M)
"""Gravity over the gas constant of air and the lapse rate."""


class PlaceTopics:
    """Publishes what a satellite receiver, a barometer and a magnetometer without errors measure.

    Args:
        publishers: Where the messages go.
        base_frame: Frame of the rig.
        magnetic_year: Year of the magnetic field, with its fraction.
    """

    def __init__(self, publishers: Publishers, base_frame: str, magnetic_year: float) -> None:
        self._publishers = publishers
        self._base_frame = base_frame
        self._magnetic_year = magnetic_year
        self._fix = publishers.offer(NavSatFix, "fix", SENSOR_QOS)
        self._pressure = publishers.offer(FluidPressure, "pressure", SENSOR_QOS)
        self._magnetic = publishers.offer(MagneticField, "magnetic_field", SENSOR_QOS)

    def publish(self, pose: Pose, georeference: Georeference | None, stamp: Time) -> None:
        """Publish where the rig is; nothing of a ground that is of no place on Earth."""
        offered = (self._fix, self._pressure, self._magnetic)
        wanted = [each for each in offered if has_subscribers(each)]
        if georeference is None or not wanted or not is_on_earth(georeference):
            return
        header = Header(stamp=stamp, frame_id=self._base_frame)
        fix = fix_msg(pose, georeference, header)
        if self._fix in wanted:
            self._publishers.send(self._fix, fix)
        if self._pressure in wanted:
            pressure = FluidPressure(header=header, fluid_pressure=air_pressure_pa(fix.altitude))
            self._publishers.send(self._pressure, pressure)
        if self._magnetic in wanted:
            x, y, z = magnetic_field_t(pose, georeference, self._magnetic_year).tolist()
            field = MagneticField(header=header, magnetic_field=Vector3(x=x, y=y, z=z))
            self._publishers.send(self._magnetic, field)


def is_on_earth(georeference: Georeference) -> bool:
    """Return whether a place is on a body of Earth's size."""
    geod = places.system_of(georeference.wkt).get_geod()
    return geod is not None and isclose(geod.a, EARTH_RADIUS_M, rel_tol=0.001)


def fix_msg(pose: Pose, georeference: Georeference, header: Header) -> NavSatFix:
    """Return the exact place of a pose; the altitude is the elevation of the ground's model."""
    lon_deg, lat_deg, altitude_m = places.lon_lat_height(georeference, pose.position_m)[0]
    status = NavSatStatus(status=NavSatStatus.STATUS_FIX, service=NavSatStatus.SERVICE_GPS)
    return NavSatFix(
        header=header,
        status=status,
        latitude=float(lat_deg),
        longitude=float(lon_deg),
        altitude=float(altitude_m),
        position_covariance_type=NavSatFix.COVARIANCE_TYPE_KNOWN,
    )


def air_pressure_pa(altitude_m: float) -> float:
    """Return the pressure of standard air at an altitude of up to 11 km (ISO 2533:1975)."""
    share = 1 - LAPSE_K_M * altitude_m / SEA_LEVEL_K
    return float(SEA_LEVEL_PA * max(share, 0.0) ** EXPONENT)


def magnetic_field_t(pose: Pose, georeference: Georeference, year: float) -> FloatArray:
    """Return Earth's magnetic field at a pose by the World Magnetic Model 2025.

    Args:
        pose: Of the rig in ``map``.
        georeference: Of the ground; elevations count as heights above the ellipsoid.
        year: From 2025 to 2030, with its fraction.

    Returns:
        (3,) tesla along the rig's x, y and z.
    """
    ((lon_deg, lat_deg, height_m),) = places.lon_lat_height(georeference, pose.position_m)
    field = _world_magnetic_model().calculate(
        glat=float(lat_deg), glon=float(lon_deg), alt=float(height_m) / 1000, time=year
    )
    north_rad = radians(places.north_deg(georeference))
    c, s = cos(north_rad), sin(north_rad)
    in_map = np.array((c * field.y - s * field.x, s * field.y + c * field.x, -field.z)) * 1e-9
    return np.asarray(pose_to_matrix(pose)[:3, :3].T @ in_map)


@lru_cache(maxsize=1)
def _world_magnetic_model() -> GeoMag:
    from pygeomag import GeoMag

    return GeoMag(coefficients_file="wmm/WMM_2025.COF")


def map_on_earth(
    georeference: Georeference | None, earth_frame: str, map_frame: str, stamp: Time
) -> list[TransformStamped]:
    """Return the transform from Earth's frame to that of the world; none without a place there."""
    if not earth_frame or georeference is None or not is_on_earth(georeference):
        return []
    header = Header(stamp=stamp, frame_id=earth_frame)
    return [transform_to_msg(places.transform_earth_map(georeference), header, map_frame)]
