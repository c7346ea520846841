"""Topic ``~/esdf_slice``: distances to the mapped surface at a height, as voxblox tells them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge.clouds import distances_to_cloud_msg
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.mapper.fusion import Fusion
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.ground_topics import LOOK_S
from oaisys_ros_bridge.publishing.map_schedule import MapSchedule, NewestView
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.timers import steady_timer


class EsdfTopic:
    """Publishes a slice of the distance field around the newest view, latched, to subscribers.

    Args:
        node: The mapper.
        fusion: Has the map.
        newest_view: Returns the newest view in the map; None: there is none.
        settings: Returns the mapper's parameters.
    """

    def __init__(
        self,
        node: Node,
        fusion: Fusion,
        newest_view: Callable[[], NewestView | None],
        settings: Settings,
    ) -> None:
        self._fusion = fusion
        self._settings = settings
        self._schedule = MapSchedule(node, "slice of distances", newest_view)
        self._slice = node.create_publisher(PointCloud2, "~/esdf_slice", LATCHED_QOS)
        if settings()["esdf.length_m"]:
            steady_timer(node, LOOK_S, self._publish_new, MutuallyExclusiveCallbackGroup())

    def _publish_new(self) -> None:
        values = self._settings()
        if not self._slice.get_subscription_count():
            return
        view = self._schedule.take(values["esdf.period_s"])
        if view is None:
            return
        try:
            points = self._find(view, values["esdf.slice_level"])
        except OaisysError as error:
            self._schedule.tell(str(error))
            return
        self._schedule.tell("")
        if not self._schedule.still_has(view):
            return
        stamp = stamp_from_nanoseconds(view.stamp_ns)
        header = Header(stamp=stamp, frame_id=values["map_frame"])
        self._slice.publish(distances_to_cloud_msg(points, header))

    def _find(self, view: NewestView, level_m: float) -> NDArray[np.float32]:
        """Return (N, 4) known points of the slice: x, y, z in ``map``, and the distance."""
        most_m = self._settings()["esdf.max_distance_m"]
        half_m = self._settings()["esdf.length_m"] / 2
        middle_m = np.array([*view.xy_m, level_m])
        # Surfaces up to the largest distance away count, also those beside the slice.
        reach_m = np.array([half_m + most_m, half_m + most_m, most_m + self._fusion.voxel_size_m])
        field = self._fusion.distance_field(middle_m - reach_m, middle_m + reach_m)
        distance_m = np.clip(field.slice_at(level_m), -most_m, most_m)
        columns, rows = np.nonzero(np.isfinite(distance_m))
        xy_m = field.origin_m[:2] + field.voxel_size_m * np.column_stack((columns, rows))
        is_near = (np.abs(xy_m - view.xy_m) <= half_m).all(axis=1)
        found_m = distance_m[columns, rows]
        levels_m = np.full(len(xy_m), level_m)
        points = np.column_stack((xy_m, levels_m, found_m))[is_near]
        return np.asarray(points, np.float32)
