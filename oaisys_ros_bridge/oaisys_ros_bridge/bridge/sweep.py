"""Action ``~/sweep``: one sample at each of many poses, with feedback, until it is cancelled."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from oaisys_core.errors import CancelledError, OaisysError
from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.bridge.goal_server import GoalServer, GoalWork
from oaisys_ros_bridge.bridge.rendering import Renderer
from oaisys_ros_bridge.bridge.requests import Cancellation, ViewRequest, checked_frame


def sweep_server(node: Node, renderer: Renderer) -> GoalServer:
    """Offer the action; each pose is a request of its own, so other requests come in between.

    A sweep ends once our mapper and recorders have taken all samples. Otherwise its result says
    which of them have not, and what they have lost.
    """

    def run(goal: ServerGoalHandle, cancellation: Cancellation, result: Sweep.Result) -> None:
        array = goal.request.poses
        before = renderer.readers.states()
        checked_frame(array.header.frame_id, "poses.header.frame_id", renderer.map_frame)
        for index, pose in enumerate(array.poses):
            request = ViewRequest(PoseStamped(header=array.header, pose=pose))
            try:
                sample, _ = renderer.render(request, cancellation)
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
    """Write into a result why the sweep has failed, and how many poses it had rendered."""
    total = len(goal.request.poses.poses)
    result.message = f"{reason}; {len(result.sample_ids)} of {total} poses were rendered"
