"""Where the rig is on Earth, if the ground says where it lies."""

from __future__ import annotations

from math import isclose

from builtin_interfaces.msg import Time
from sensor_msgs.msg import NavSatFix, NavSatStatus
from std_msgs.msg import Header

from oaisys_core.geometry import places
from oaisys_core.types import Georeference, Pose
from oaisys_ros_bridge.publishing.publishers import Publishers, has_subscribers
from oaisys_ros_bridge.qos import SENSOR_QOS

EARTH_RADIUS_M = 6_378_137.0
"""Equatorial radius of WGS 84, on which a NavSatFix is by its definition."""


class PlaceTopics:
    """Publishes the true place of the rig as a satellite receiver would.

    Args:
        publishers: Where the messages go.
        base_frame: Frame of the rig.
    """

    def __init__(self, publishers: Publishers, base_frame: str) -> None:
        self._publishers = publishers
        self._base_frame = base_frame
        self._fix = publishers.offer(NavSatFix, "fix", SENSOR_QOS)

    def publish(self, pose: Pose, georeference: Georeference | None, stamp: Time) -> None:
        """Publish where the rig is; nothing of a ground that is of no place on Earth."""
        if georeference is None or not has_subscribers(self._fix) or not is_on_earth(georeference):
            return
        header = Header(stamp=stamp, frame_id=self._base_frame)
        self._publishers.send(self._fix, fix_msg(pose, georeference, header))


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
