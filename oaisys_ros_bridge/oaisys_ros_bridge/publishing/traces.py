"""What viewers draw of a run so far: the rig's path, and the frusta of all views.

Both begin anew with each world. A path is sent whole with each sample; frusta one by one, and all
of them to whoever comes later, within `GREETING_PERIOD_S`.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from oaisys_core.types import FloatArray, PinholeIntrinsics, Sample
from oaisys_ros_bridge.conversions import pose_to_stamped_msg
from oaisys_ros_bridge.nodes.node_process import OWN_CLOCK
from oaisys_ros_bridge.publishing.markers import deletion_marker, deletion_of_all, frustum_to_marker
from oaisys_ros_bridge.publishing.options import PublishingOptions
from oaisys_ros_bridge.publishing.publishers import Publishers, is_heard
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, PATH_QOS

GREETING_PERIOD_S = 1.0
"""Between two looks for subscribers that were not there before."""

World = tuple[str, int, int]
"""Hash of the configuration, root seed and batch: what a trace belongs to."""


@dataclass(frozen=True)
class Viewpoint:
    """A view that was taken.

    Attributes:
        number: Id of its marker.
        sensor: Which camera took it.
        intrinsics: The camera as it was then.
        T_map_camera: (4, 4) pose of its optical frame.
        header: Stamp of its sample, frame of the world.
    """

    number: int
    sensor: str
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    header: Header


class Traces:
    """Publishes ``path`` and ``viewpoints``.

    Args:
        node: Owner of the timer that looks for newcomers.
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
        self._views: deque[Viewpoint] = deque()
        self._taken = 0
        self._depth_m = 0.0
        self._path = publishers.offer(Path, "path", PATH_QOS)
        self._viewpoints = publishers.offer(MarkerArray, "viewpoints", LATCHED_HISTORY_QOS)
        self._audience = {publisher.topic_name: 0 for publisher in (self._path, self._viewpoints)}
        group = MutuallyExclusiveCallbackGroup()
        self._timer = node.create_timer(
            GREETING_PERIOD_S, self._greet, callback_group=group, clock=OWN_CLOCK
        )

    def destroy(self) -> None:
        """Take the timer off the node."""
        self._node.destroy_timer(self._timer)

    def enter(self, world: World) -> None:
        """Begin anew if this is another world than that of the samples so far."""
        with self._lock:
            if self._world in (None, world):
                self._world = world
                return
            self._world = world
            self._poses.clear()
            self._views.clear()
            self._path.publish(self._path_msg())
            self._viewpoints.publish(MarkerArray(markers=[deletion_of_all(self._header)]))

    def add(self, sample: Sample, stamp: Time, options: PublishingOptions) -> None:
        """Draw a sample that is complete."""
        how = sample.provenance
        self.enter((how.config_sha256, how.seed, sample.batch_id))
        with self._lock:
            self._header = Header(stamp=stamp, frame_id=self._map_frame)
            self._depth_m = options.viewpoints_depth_m
            self._poses.append(pose_to_stamped_msg(sample.rig_pose, self._header))
            while len(self._poses) > options.path_length:
                self._poses.popleft()
            if is_heard(self._path):
                self._publishers.send(self._path, self._path_msg())
            begun, gone = self._take_in(sample, options.viewpoints_count)
            if is_heard(self._viewpoints) and (begun or gone):
                markers = [
                    deletion_marker(self._header, ns=view.sensor, number=view.number)
                    for view in gone
                ]
                markers += map(self._marker, begun)
                self._publishers.send(self._viewpoints, MarkerArray(markers=markers))

    def _take_in(self, sample: Sample, most: int) -> tuple[list[Viewpoint], list[Viewpoint]]:
        """Return a sample's views that are shown from now on, and those that no longer are."""
        for sensor, frame in {frame.sensor: frame for frame in sample.frames}.items():
            self._taken += 1
            self._views.append(
                Viewpoint(self._taken, sensor, frame.intrinsics, frame.T_map_camera, self._header)
            )
        gone = []
        while len(self._views) > most:
            gone.append(self._views.popleft())
        begun = [view for view in self._views if view.header is self._header]
        return begun, [view for view in gone if view.header is not self._header]

    def _greet(self) -> None:
        """Send everything to subscribers who have come since the last look."""
        with self._lock:
            if self._has_newcomers(self._path) and self._poses:
                self._path.publish(self._path_msg())
            if self._has_newcomers(self._viewpoints) and self._views:
                markers = [deletion_of_all(self._header), *map(self._marker, self._views)]
                self._viewpoints.publish(MarkerArray(markers=markers))

    def _has_newcomers(self, publisher: Publisher) -> bool:
        before = self._audience[publisher.topic_name]
        now = int(publisher.get_subscription_count())
        self._audience[publisher.topic_name] = now
        return now > before

    def _path_msg(self) -> Path:
        return Path(header=self._header, poses=list(self._poses))

    def _marker(self, view: Viewpoint) -> Marker:
        return frustum_to_marker(
            view.intrinsics,
            view.T_map_camera,
            self._depth_m,
            view.header,
            ns=view.sensor,
            number=view.number,
        )
