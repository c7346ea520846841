"""Topics of the ground around the rig: a grid map of several layers, and an occupancy grid."""

from __future__ import annotations

from collections.abc import Callable

from builtin_interfaces.msg import Time
from grid_map_msgs.msg import GridMap
from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Header

from oaisys_core.errors import OaisysError
from oaisys_mapping.ground_grid import GridPlace, GroundGrid
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.ground_maps import ground_msgs
from oaisys_ros_bridge.parameters.ground_maps import check_ground_map, rover_of
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.map_schedule import MapSchedule, NewestView
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.timers import steady_timer

LOOK_S = 0.5
"""Between two looks whether a map is due; a new view is looked at when it comes.

Each look wakes the node's executor, which takes 2 ms of CPU time.
"""


class GroundTopics:
    """Publishes the ground, latched, to whoever subscribes.

    Args:
        node: Owner of the publishers.
        prefix: Of the topics.
        newest_view: Returns the newest view; None: there is none.
        find_ground: Returns the ground in a place; called on a thread that may wait.
        settings: Returns the node's parameters.
    """

    def __init__(
        self,
        node: Node,
        prefix: str,
        newest_view: Callable[[], NewestView | None],
        find_ground: Callable[[GridPlace], GroundGrid],
        settings: Settings,
    ) -> None:
        self._schedule = MapSchedule(node, "map of the ground", newest_view)
        self._find_ground = find_ground
        self._settings = settings
        self._grid_map = node.create_publisher(GridMap, f"{prefix}grid_map", LATCHED_QOS)
        self._occupancy = node.create_publisher(OccupancyGrid, f"{prefix}occupancy", LATCHED_QOS)
        group = MutuallyExclusiveCallbackGroup()
        self._sample = node.create_guard_condition(self.publish_new, callback_group=group)
        steady_timer(node, LOOK_S, self.publish_new, group)

    def note_view(self) -> None:
        """Look soon whether a map is due."""
        self._sample.trigger()

    def publish_new(self) -> None:
        """Publish the ground around the newest view if that is due and somebody subscribes."""
        values = self._settings()
        if not values["ground_map.length_m"] or not self._has_subscribers():
            return
        view = self._schedule.take(values["ground_map.period_s"])
        if view is None:
            return
        length_m, cell_m = values["ground_map.length_m"], values["ground_map.resolution_m"]
        try:
            check_ground_map(values)
            grid = self._find_ground(GridPlace.around(view.xy_m, length_m, cell_m))
        except OaisysError as error:
            self._schedule.tell(str(error))
            return
        self._schedule.tell("")
        if not self._schedule.still_has(view):
            return
        stamp: Time = stamp_from_nanoseconds(view.stamp_ns)
        header = Header(stamp=stamp, frame_id=values["map_frame"])
        grid_map, occupancy = ground_msgs(grid, rover_of(values), header)
        self._grid_map.publish(grid_map)
        self._occupancy.publish(occupancy)

    def _has_subscribers(self) -> bool:
        publishers = (self._grid_map, self._occupancy)
        return any(publisher.get_subscription_count() for publisher in publishers)
