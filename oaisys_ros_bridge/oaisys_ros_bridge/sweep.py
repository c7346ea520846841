"""Action ``~/sweep``: one sample at each of many poses, with feedback, until it is cancelled."""

from __future__ import annotations

import threading
import time

from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from oaisys_core.errors import CancelledError, OaisysError
from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.cancellation import Cancellation
from oaisys_ros_bridge.rendering import Renderer, View
from oaisys_ros_bridge.requests import checked_frame

CANCELLING_TIMEOUT_S = 1.0
END_TIMEOUT_S = 3.0
CANCELLED = "cancelled"


class SweepServer:
    """Serves one sweep at a time; a goal that comes meanwhile is aborted with that reason.

    Args:
        node: That the action is of.
        renderer: Renders each pose in a turn of its own.
    """

    def __init__(self, node: Node, renderer: Renderer) -> None:
        self._node = node
        self._renderer = renderer
        self._lock = threading.Lock()
        self._running: Cancellation | None = None
        self._accepted: dict[bytes, Cancellation] = {}
        self._idle = threading.Event()
        self._idle.set()
        self._server = ActionServer(
            node,
            Sweep,
            "~/sweep",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    def stop(self, reason: str) -> None:
        """End the goal that runs, and wait for that."""
        with self._lock:
            running = self._running
        if running is not None:
            running.request(reason)
            self._idle.wait(END_TIMEOUT_S)

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        self._accepted[bytes(goal.goal_id.uuid)] = Cancellation()
        goal.execute()

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        cancellation = self._accepted.get(bytes(goal.goal_id.uuid))
        if cancellation is not None:
            cancellation.request(CANCELLED)
        return CancelResponse.ACCEPT

    def _execute(self, goal: ServerGoalHandle) -> Sweep.Result:
        key = bytes(goal.goal_id.uuid)
        cancellation = self._accepted[key]
        try:
            return self._executed(goal, cancellation)
        finally:
            del self._accepted[key]

    def _executed(self, goal: ServerGoalHandle, cancellation: Cancellation) -> Sweep.Result:
        result = Sweep.Result()
        if not self._begin(cancellation):
            result.message = "another sweep runs: one at a time, cancel that one or wait for it"
            goal.abort()
            return result
        try:
            self._sweep(goal, cancellation, result)
            result.success = True
            goal.succeed()
        except CancelledError as error:
            done = f"{len(result.sample_ids)} of {len(goal.request.poses.poses)} poses"
            result.message = f"{cancellation.reason or error} after {done}"
            self._end_cancelled(goal, cancellation)
        except OaisysError as error:
            result.message = str(error)
            goal.abort()
        finally:
            self._end()
        if result.message:
            self._node.get_logger().warning(f"sweep ended: {result.message}")
        return result

    def _sweep(
        self, goal: ServerGoalHandle, cancellation: Cancellation, result: Sweep.Result
    ) -> None:
        """Render pose by pose; what was published until an error stays in the result."""
        array = goal.request.poses
        checked_frame(array.header.frame_id, "poses.header.frame_id", self._renderer.map_frame())
        total = len(array.poses)
        for index, pose in enumerate(array.poses):
            view = View(PoseStamped(header=array.header, pose=pose))
            try:
                sample, _ = self._renderer.render(view, cancellation)
            except CancelledError:
                raise
            except OaisysError as error:
                raise OaisysError(f"poses.poses[{index}]: {error}") from error
            result.sample_ids.append(sample.sample_id)
            goal.publish_feedback(
                Sweep.Feedback(index=index + 1, total=total, render_time=sample.render_time_s)
            )

    def _end_cancelled(self, goal: ServerGoalHandle, cancellation: Cancellation) -> None:
        """End as cancelled where a client has asked for that, and as aborted otherwise."""
        end_s = time.monotonic() + CANCELLING_TIMEOUT_S
        asked = cancellation.reason == CANCELLED
        # The client's wish is known here a moment before the goal's state says so.
        while asked and not goal.is_cancel_requested and time.monotonic() < end_s:
            time.sleep(0.005)
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()

    def _begin(self, cancellation: Cancellation) -> bool:
        with self._lock:
            if self._running is not None:
                return False
            self._running = cancellation
            self._idle.clear()
            return True

    def _end(self) -> None:
        with self._lock:
            self._running = None
            self._idle.set()
