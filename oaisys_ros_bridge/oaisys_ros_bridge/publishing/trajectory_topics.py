"""The path of the rig, and the frusta of all views."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped, Vector3
from nav_msgs.msg import Path
from numpy.typing import ArrayLike
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from oaisys_core.geometry import pose_from_matrix, unproject
from oaisys_core.types import FloatArray, PinholeIntrinsics, Sample
from oaisys_ros_bridge.conversions import pose_to_msg, pose_to_stamped_msg
from oaisys_ros_bridge.publishing.publishers import Publishers, TopicPublisher, has_subscribers
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, PATH_QOS
from oaisys_ros_bridge.timers import steady_timer

NEW_SUBSCRIBER_PERIOD_S = 1.0
"""Between two checks for new subscribers."""

LINE_WIDTH_SHARE = 0.02
"""Width of a frustum's edges, as a share of its depth."""
COLOR = ColorRGBA(r=1.0, g=0.75, b=0.1, a=1.0)

World = tuple[str, int, int]
"""Hash of the configuration, root seed and batch: which world a path belongs to."""


@dataclass(frozen=True)
class Frustum:
    """The frustum of one camera at one sample.

    Attributes:
        number: Id of its marker.
        sensor: Name of the camera.
        intrinsics: The camera as it was then.
        T_map_camera: (4, 4) pose of its optical frame.
        header: Stamp of its sample, frame of the world.
    """

    number: int
    sensor: str
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    header: Header


class TrajectoryTopics:
    """Publishes ``path`` and ``viewpoints``: the poses, and the frusta of all views, in this world.

    Each sample brings the whole path, but only its own frusta; late subscribers get all of them
    within `NEW_SUBSCRIBER_PERIOD_S`.

    Args:
        node: Owner of the timer that checks for new subscribers.
        publishers: Of the node.
        map_frame: Frame of the world.
    """

    def __init__(self, node: Node, publishers: Publishers, map_frame: str) -> None:
        self._node = node
        self._publishers = publishers
        self._map_frame = map_frame
        self._lock = threading.Lock()
        self._world: World | None = None
        self._header = Header(frame_id=map_frame)
        self._poses: deque[PoseStamped] = deque()
        self._views: deque[Frustum] = deque()
        self._taken = 0
        self._depth_m = 0.0
        self._path = publishers.offer(Path, "path", PATH_QOS)
        self._viewpoints = publishers.offer(MarkerArray, "viewpoints", LATCHED_HISTORY_QOS)
        self._subscribers = {
            publisher.topic_name: 0 for publisher in (self._path, self._viewpoints)
        }
        self._timer = steady_timer(node, NEW_SUBSCRIBER_PERIOD_S, self._greet_subscribers)

    def destroy(self) -> None:
        """Take the timer off the node."""
        self._node.destroy_timer(self._timer)

    def enter(self, world: World) -> None:
        """Clear both topics if this is another world than that of the samples so far."""
        with self._lock:
            if self._world in (None, world):
                self._world = world
                return
            self._world = world
            self._poses.clear()
            self._views.clear()
            self._path.publish(self._path_msg())
            self._viewpoints.publish(MarkerArray(markers=[deletion_of_all(self._header)]))

    def add(self, sample: Sample, stamp: Time, values: Mapping[str, Any]) -> None:
        """Add a complete sample, given the values of the bridge's parameters."""
        how = sample.provenance
        self.enter((how.config_sha256, how.seed, sample.batch_id))
        with self._lock:
            self._header = Header(stamp=stamp, frame_id=self._map_frame)
            self._depth_m = values["viewpoints.depth_m"]
            self._poses.append(pose_to_stamped_msg(sample.rig_pose, self._header))
            while len(self._poses) > values["path.length"]:
                self._poses.popleft()
            if has_subscribers(self._path):
                self._publishers.send(self._path, self._path_msg())
            added, removed = self._add_views(sample, values["viewpoints.count"])
            if has_subscribers(self._viewpoints) and (added or removed):
                markers = [
                    deletion_marker(self._header, ns=view.sensor, number=view.number)
                    for view in removed
                ]
                markers += map(self._marker, added)
                self._publishers.send(self._viewpoints, MarkerArray(markers=markers))

    def _add_views(self, sample: Sample, most: int) -> tuple[list[Frustum], list[Frustum]]:
        """Add a sample's views; return the new ones and the ones that are no longer shown."""
        for sensor, frame in {frame.sensor: frame for frame in sample.frames}.items():
            self._taken += 1
            self._views.append(
                Frustum(self._taken, sensor, frame.intrinsics, frame.T_map_camera, self._header)
            )
        removed = []
        while len(self._views) > most:
            removed.append(self._views.popleft())
        added = [view for view in self._views if view.header is self._header]
        return added, [view for view in removed if view.header is not self._header]

    def _greet_subscribers(self) -> None:
        """Publish everything again if there are new subscribers."""
        with self._lock:
            if self._has_new_subscribers(self._path) and self._poses:
                self._path.publish(self._path_msg())
            if self._has_new_subscribers(self._viewpoints) and self._views:
                markers = [deletion_of_all(self._header), *map(self._marker, self._views)]
                self._viewpoints.publish(MarkerArray(markers=markers))

    def _has_new_subscribers(self, publisher: TopicPublisher) -> bool:
        before = self._subscribers[publisher.topic_name]
        now = int(publisher.get_subscription_count())
        self._subscribers[publisher.topic_name] = now
        return now > before

    def _path_msg(self) -> Path:
        return Path(header=self._header, poses=list(self._poses))

    def _marker(self, view: Frustum) -> Marker:
        return frustum_to_marker(
            view.intrinsics,
            view.T_map_camera,
            self._depth_m,
            view.header,
            ns=view.sensor,
            number=view.number,
        )


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
    """Return the eight edges of a camera's frustum, up to a depth.

    Args:
        intrinsics: The camera; a lens's distortion moves the corners.
        T_map_camera: (4, 4) pose of the optical frame in ``header``'s frame.
        depth_m: Depth of the base, along the optical axis.
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
    """Return the marker that deletes one."""
    return Marker(header=header, ns=ns, id=number, action=Marker.DELETE)


def deletion_of_all(header: Header) -> Marker:
    """Return the marker that deletes all markers of a topic."""
    return Marker(header=header, action=Marker.DELETEALL)
