"""Pure conversions of viewpoints to markers: the pyramid that a camera sees of the world."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Vector3
from numpy.typing import ArrayLike
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from oaisys_core.geometry import pose_from_matrix, unproject
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_ros_bridge.conversions import pose_to_msg

LINE_WIDTH_SHARE = 0.02
"""Width of a frustum's edges, as a share of its depth."""
COLOR = ColorRGBA(r=1.0, g=0.75, b=0.1, a=1.0)


def image_corners(intrinsics: PinholeIntrinsics) -> FloatArray:
    """Return the (4, 2) pixels of the image's outer corners, clockwise from the upper left."""
    right, bottom = intrinsics.width_px - 0.5, intrinsics.height_px - 0.5
    return np.array([(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)])


def frustum_to_marker(
    intrinsics: PinholeIntrinsics,
    T_map_camera: ArrayLike,
    depth_m: float,
    header: Header,
    *,
    ns: str,
    number: int,
) -> Marker:
    """Return the eight edges of what a camera sees up to a depth.

    Args:
        intrinsics: The camera; a lens's distortion moves the corners.
        T_map_camera: (4, 4) pose of the optical frame in ``header``'s frame.
        depth_m: Of the base, along the optical axis.
        header: Stamp and frame.
        ns: Namespace of the marker, such as the sensor's name.
        number: Id of the marker in its namespace.
    """
    corners_m = unproject(image_corners(intrinsics), np.full(4, depth_m), intrinsics)
    apex = Point()
    base = [Point(x=x, y=y, z=z) for x, y, z in corners_m.tolist()]
    marker = Marker(header=header, ns=ns, id=number, type=Marker.LINE_LIST, action=Marker.ADD)
    marker.pose = pose_to_msg(pose_from_matrix(T_map_camera))
    marker.scale = Vector3(x=depth_m * LINE_WIDTH_SHARE)
    marker.color = COLOR
    for corner, following in zip(base, [*base[1:], base[0]], strict=True):
        marker.points += [apex, corner, corner, following]
    return marker


def deletion_marker(header: Header, *, ns: str, number: int) -> Marker:
    """Return the marker that takes one away."""
    return Marker(header=header, ns=ns, id=number, action=Marker.DELETE)


def deletion_of_all(header: Header) -> Marker:
    """Return the marker that takes all of its topic away."""
    return Marker(header=header, action=Marker.DELETEALL)
