"""Requests for several poses: ``command/pose``, ``command/trajectory`` and action ``~/sweep``."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from trajectory_msgs.msg import MultiDOFJointTrajectory

from oaisys_core.errors import CancelledError, OaisysError
from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.bags.losses import MissingNumbers
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.requests import (
    Cancellation,
    ViewRequest,
    check_count,
    poses_in_map,
    poses_of_trajectory,
)
from oaisys_ros_bridge.conversions import duration_from_seconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import NEWEST_QOS


class PoseCommands:
    """Renders the poses of the newest command, each as a request of its own.

    A newer command replaces what is left of the one before as soon as it comes; the view that is
    being rendered is finished first. The poses that are left are kept here: the middleware's queue
    of one message cannot let a pose replace a trajectory, which comes on another topic. Commands
    that a newer one has replaced in that queue are counted as dropped, too, by the gaps in the
    numbers of a topic's only publisher.

    Args:
        node: The bridge.
        render_queue: Renders the poses.
        settings: Returns the bridge's parameters.
    """

    def __init__(self, node: Node, render_queue: RenderQueue, settings: Settings) -> None:
        self._render_queue = render_queue
        self._settings = settings
        self._node = node
        self._lock = threading.Lock()
        self._missing_numbers = MissingNumbers()
        self._poses: deque[PoseStamped] = deque()
        self._has_come = node.create_guard_condition(
            self._render, callback_group=MutuallyExclusiveCallbackGroup()
        )
        group = MutuallyExclusiveCallbackGroup()
        commands: tuple[tuple[Any, str, Callable[[Any], None]], ...] = (
            (PoseStamped, "command/pose", self._on_pose),
            (MultiDOFJointTrajectory, "command/trajectory", self._on_trajectory),
        )
        for kind, name, callback in commands:
            counted = partial(self._on_command, node.resolve_topic_name(name), callback)
            node.create_subscription(kind, name, counted, NEWEST_QOS, callback_group=group)

    def clear(self) -> None:
        """Drop all poses."""
        self._replace(())

    def _on_command(
        self, topic: str, callback: Callable[[Any], None], message: Any, info: dict[str, int]
    ) -> None:
        missing = self._missing_numbers.before(topic, info["publication_sequence_number"])
        if missing and self._node.count_publishers(topic) == 1:
            with self._lock:
                self._render_queue.counts.dropped_commands += missing
        callback(message)

    def _on_pose(self, pose: PoseStamped) -> None:
        self._replace([pose])

    def _on_trajectory(self, trajectory: MultiDOFJointTrajectory) -> None:
        points = self._settings()["trajectory_points"]
        try:
            self._replace(poses_of_trajectory(trajectory, points, self._render_queue.frames))
        except OaisysError as error:
            self._node.get_logger().warning(f"command/trajectory refused: {error}")

    def _replace(self, poses: Sequence[PoseStamped]) -> None:
        with self._lock:
            self._render_queue.counts.dropped_commands += len(self._poses)
            self._poses = deque(poses)
            self._render_queue.counts.waiting_commands = len(self._poses)
        self._has_come.trigger()

    def _render(self) -> None:
        while self._poses:
            try:
                self._render_queue.render_next(self._pop)
            except OaisysError as error:
                self._node.get_logger().warning(f"command failed: {error}")

    def _pop(self) -> ViewRequest | None:
        """Return the next pose of the command that is the newest by now."""
        with self._lock:
            if not self._poses:
                return None
            pose = self._poses.popleft()
            self._render_queue.counts.waiting_commands = len(self._poses)
            return ViewRequest(pose)


def sweep_server(node: Node, render_queue: RenderQueue) -> GoalServer:
    """Offer the action; each pose is a request of its own, so other requests come in between.

    A sweep ends once our mapper and recorders have taken all samples. Otherwise its result says
    which of them have not, and what they have lost.
    """

    def run(goal: ServerGoalHandle, cancellation: Cancellation, result: Sweep.Result) -> None:
        array = goal.request.poses
        check_count("poses.poses", array.poses)
        # What readers have yet to find missing of earlier samples is not this goal's loss.
        render_queue.back_pressure.wait_until_taken(cancellation)
        before = render_queue.back_pressure.states()
        # Now: the sweep itself moves the frames of the rig.
        in_map = poses_in_map(array.header, render_queue.frames, "poses.header")
        for index, pose in enumerate(array.poses):
            try:
                sample, _ = render_queue.render(ViewRequest(in_map(pose)), cancellation)
            except CancelledError:
                raise
            except OaisysError as error:
                raise OaisysError(f"poses.poses[{index}]: {error}") from error
            result.sample_ids.append(sample.sample_id)
            feedback = Sweep.Feedback(index=index + 1, total=len(array.poses))
            feedback.render_time = sample.render_time_s
            feedback.render_duration = duration_from_seconds(sample.render_time_s)
            goal.publish_feedback(feedback)
        render_queue.back_pressure.wait_until_taken(cancellation)
        result.success = True
        result.message = "; ".join(render_queue.back_pressure.shortfalls(before))

    return GoalServer(node, GoalWork(Sweep, "~/sweep", run, _explain))


def _explain(goal: ServerGoalHandle, result: Sweep.Result, reason: str) -> None:
    """Write into a result why the sweep has failed, and how many poses it had rendered."""
    total = len(goal.request.poses.poses)
    result.message = f"{reason}; {len(result.sample_ids)} of {total} poses were rendered"
