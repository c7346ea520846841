"""Topics ``command/pose`` and ``command/trajectory``: the poses of the newest command are rendered.

The poses that are left of a command are kept here: the middleware's queue of one message cannot let
a pose replace a trajectory, which comes on another topic.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from trajectory_msgs.msg import MultiDOFJointTrajectory

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge.bridge.rendering import Renderer
from oaisys_ros_bridge.bridge.requests import ViewRequest, poses_of_trajectory
from oaisys_ros_bridge.qos import NEWEST_QOS


class PoseCommands:
    """Renders the poses of the newest command, each as a request of its own.

    A newer command replaces what is left of the one before as soon as it comes; the view that is
    being rendered is finished first.

    Args:
        node: The bridge.
        renderer: Renders the poses.
        settings: Returns the bridge's parameters.

    Attributes:
        dropped: How many poses were replaced before they were rendered.
    """

    def __init__(
        self, node: Node, renderer: Renderer, settings: Callable[[], Mapping[str, Any]]
    ) -> None:
        self._renderer = renderer
        self._settings = settings
        self._node = node
        self._lock = threading.Lock()
        self._poses: deque[PoseStamped] = deque()
        self.dropped = 0
        self._has_come = node.create_guard_condition(
            self._render, callback_group=MutuallyExclusiveCallbackGroup()
        )
        group = MutuallyExclusiveCallbackGroup()
        commands: tuple[tuple[Any, str, Callable[[Any], None]], ...] = (
            (PoseStamped, "command/pose", self._on_pose),
            (MultiDOFJointTrajectory, "command/trajectory", self._on_trajectory),
        )
        for kind, name, callback in commands:
            node.create_subscription(kind, name, callback, NEWEST_QOS, callback_group=group)

    @property
    def waiting(self) -> int:
        """How many poses are still to be rendered."""
        return len(self._poses)

    def clear(self) -> None:
        """Drop all poses."""
        self._replace(())

    def _on_pose(self, pose: PoseStamped) -> None:
        self._replace([pose])

    def _on_trajectory(self, trajectory: MultiDOFJointTrajectory) -> None:
        points = self._settings()["trajectory_points"]
        try:
            self._replace(poses_of_trajectory(trajectory, points, self._renderer.map_frame))
        except OaisysError as error:
            self._node.get_logger().warning(f"command/trajectory refused: {error}")

    def _replace(self, poses: Sequence[PoseStamped]) -> None:
        with self._lock:
            self.dropped += len(self._poses)
            self._poses = deque(poses)
        self._has_come.trigger()

    def _render(self) -> None:
        while self._poses:
            try:
                self._renderer.render_next(self._pop)
            except OaisysError as error:
                self._node.get_logger().warning(f"command refused: {error}")

    def _pop(self) -> ViewRequest | None:
        """Return the next pose of the command that is the newest by now."""
        with self._lock:
            return ViewRequest(self._poses.popleft()) if self._poses else None
