"""Action ``~/sweep``: one sample at each of many poses, with feedback, until it is cancelled."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from oaisys_core.errors import CancelledError, OaisysError
from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.bridge.cancellation import Cancellation
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.rendering import Renderer, View
from oaisys_ros_bridge.bridge.requests import checked_frame


def sweep_server(node: Node, renderer: Renderer) -> GoalServer:
    """Offer the action; each pose is rendered in a turn of its own.

    It ends once our own readers have taken all samples, or says who has not, and what is lost.
    """

    def run(goal: ServerGoalHandle, cancellation: Cancellation, result: Sweep.Result) -> None:
        array = goal.request.poses
        before = renderer.readers.states()
        checked_frame(array.header.frame_id, "poses.header.frame_id", renderer.map_frame())
        for index, pose in enumerate(array.poses):
            view = View(PoseStamped(header=array.header, pose=pose))
            try:
                sample, _ = renderer.render(view, cancellation)
            except CancelledError:
                raise
            except OaisysError as error:
                raise OaisysError(f"poses.poses[{index}]: {error}") from error
            result.sample_ids.append(sample.sample_id)
            done, render_s = index + 1, sample.render_time_s
            goal.publish_feedback(
                Sweep.Feedback(index=done, total=len(array.poses), render_time=render_s)
            )
        renderer.readers.wait_until_taken(cancellation)
        result.success = True
        result.message = "; ".join(renderer.readers.shortfalls(before))

    return GoalServer(node, GoalWork(Sweep, "~/sweep", run, _explain))


def _explain(goal: ServerGoalHandle, result: Sweep.Result, reason: str) -> None:
    """Say why a sweep has ended, and how far it got; its samples stay in the result."""
    total = len(goal.request.poses.poses)
    result.message = f"{reason}; {len(result.sample_ids)} of {total} poses were rendered"
