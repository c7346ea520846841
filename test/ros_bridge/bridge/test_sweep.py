"""The sweep action and commands without an answer, as their users see them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseArray, PoseStamped, Quaternion, Transform, Vector3
from rclpy.action.client import ClientGoalHandle
from ros_peer import Stage, User, stamped
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import StepBatch
from oaisys_ros_bridge.qos import SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

SAMPLES = "oaisys_bridge/sample_info"
SLOW_FROM_SAMPLE_3 = {"OAISYS_FAULT": "late-slow:120@3", "OAISYS_TEST_BUILD": "1"}
"""The third sample takes longer than any test once its depth is there."""


def bridged(stage: Stage, **env: str) -> User:
    server = stage.start_world(FLAT_WORLD, **env)
    stage.user.listen(SampleInfo, SAMPLES, SMALL_MESSAGE_QOS)
    stage.start_bridge(server.address)
    stage.user.wait_until_ready()
    return stage.user


@pytest.fixture(scope="module")
def shared_user(shared_stage: Stage) -> User:
    """The user of a bridge."""
    return bridged(shared_stage)


@pytest.fixture
def user(shared_user: User) -> User:
    """That user, with a new batch and no sample received."""
    assert shared_user.call(StepBatch, "step_batch", StepBatch.Request(seed=-1)).success
    shared_user.received[SAMPLES].clear()
    return shared_user


class Sweeper:
    """A client of the action, with the feedback that it got."""

    def __init__(self, user: User) -> None:
        self._user = user
        self._client = user.action_client(Sweep, "oaisys_bridge/sweep")
        self.feedback: list[tuple[int, int]] = []

    def begin(self, poses: Sequence[Pose], frame: str = "map") -> ClientGoalHandle:
        array = PoseArray(header=Header(frame_id=frame), poses=[stamped(p).pose for p in poses])
        sent = self._client.send_goal_async(Sweep.Goal(poses=array), self._on_feedback)
        goal = self._user.answer(sent)
        assert goal.accepted
        return goal

    def result(self, goal: ClientGoalHandle) -> tuple[int, Sweep.Result]:
        answer = self._user.answer(goal.get_result_async())
        return answer.status, answer.result

    def _on_feedback(self, message: Any) -> None:
        assert message.feedback.render_time > 0
        self.feedback.append((message.feedback.index, message.feedback.total))


def heights_m(user: User) -> list[float]:
    return [sample.rig_pose.position.z for sample in user.received[SAMPLES]]


def down(height_m: float) -> Pose:
    return pose_looking_down(0.0, 0.0, height_m)


@pytest.mark.long
def test_a_sweep_renders_every_pose_and_tells_how_far_it_is(user: User) -> None:
    sweeper = Sweeper(user)

    goal = sweeper.begin([down(4), down(5), down(6)])
    # A client of rclpy passes no feedback on once it has the result.
    user.wait_until(lambda: len(sweeper.feedback) == 3)
    status, result = sweeper.result(goal)

    assert (status, result.success, result.message) == (GoalStatus.STATUS_SUCCEEDED, True, "")
    assert list(result.sample_ids) == [1, 2, 3]
    user.wait_until(lambda: len(user.received[SAMPLES]) == 3)
    assert heights_m(user) == [4, 5, 6]
    assert sweeper.feedback == [(1, 3), (2, 3), (3, 3)]

    in_the_ground = sweeper.begin([down(4), down(-2), down(6)])
    status, result = sweeper.result(in_the_ground)
    assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False)
    assert "poses.poses[1]" in result.message
    assert "clearance" in result.message
    assert list(result.sample_ids) == [4]

    status, result = sweeper.result(sweeper.begin([down(4)], frame="elsewhere"))
    assert (status, list(result.sample_ids)) == (GoalStatus.STATUS_ABORTED, [])
    assert "poses.header.frame_id: received 'elsewhere'" in result.message
    status, result = sweeper.result(sweeper.begin([Pose((0, 0, math.nan), (0, 0, 0, 1))]))
    assert status == GoalStatus.STATUS_ABORTED
    assert "poses.poses[0]: pose.pose.position" in result.message
    assert user.set_pose(down(7)).sample_id == 5


def test_a_sweep_is_cancelled_in_the_middle_of_a_render_and_keeps_what_it_has(
    stage: Stage,
) -> None:
    user = bridged(stage, **SLOW_FROM_SAMPLE_3)
    sweeper = Sweeper(user)
    goal = sweeper.begin([down(4), down(5), down(6), down(7)])
    user.wait_until(lambda: len(sweeper.feedback) == len(user.received[SAMPLES]) == 2)

    second = sweeper.begin([down(9)])
    status, result = sweeper.result(second)
    assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False)
    assert "another goal of ~/sweep runs" in result.message
    cancelled = user.answer(goal.cancel_goal_async())
    status, result = sweeper.result(goal)

    assert len(cancelled.goals_canceling) == 1
    assert (status, result.success) == (GoalStatus.STATUS_CANCELED, False)
    assert result.message == "cancelled; 2 of 4 poses were rendered"
    assert list(result.sample_ids) == [1, 2]
    assert heights_m(user) == [4, 5]


@pytest.mark.long
def test_services_and_commands_go_between_two_poses_of_a_sweep(user: User) -> None:
    sweeper = Sweeper(user)
    commands = user.node.create_publisher(PoseStamped, "command/pose", 1)
    user.wait_until(lambda: commands.get_subscription_count() == 1)
    swept_m = np.linspace(3, 10, 60)
    goal = sweeper.begin([down(z) for z in swept_m])
    user.wait_until(lambda: sweeper.feedback)

    commands.publish(stamped(down(20.5)))
    assert user.set_pose(down(21.5)).success

    assert len(sweeper.feedback) < len(swept_m)
    status, result = sweeper.result(goal)
    assert (status, len(result.sample_ids)) == (GoalStatus.STATUS_SUCCEEDED, len(swept_m))
    user.wait_until(lambda: len(user.received[SAMPLES]) == len(swept_m) + 2)
    rendered_m = heights_m(user)
    assert {20.5, 21.5} <= set(rendered_m[:-1])
    assert [z for z in rendered_m if z < 20] == pytest.approx(swept_m)


def trajectory(heights: Sequence[float], frame: str = "map") -> MultiDOFJointTrajectory:
    """Waypoints of two joints, of which the second is none of ours."""

    def at(z: float) -> Transform:
        quat = down(z).quat_xyzw
        rotation = Quaternion(x=quat[0], y=quat[1], z=quat[2], w=quat[3])
        return Transform(translation=Vector3(z=float(z)), rotation=rotation)

    points = [MultiDOFJointTrajectoryPoint(transforms=[at(z), at(z + 100)]) for z in heights]
    header = Header(frame_id=frame)
    return MultiDOFJointTrajectory(header=header, joint_names=["base", "arm"], points=points)


@pytest.mark.long
def test_a_trajectory_is_flown_point_by_point_until_a_newer_command_comes(user: User) -> None:
    paths = user.node.create_publisher(MultiDOFJointTrajectory, "command/trajectory", 1)
    poses = user.node.create_publisher(PoseStamped, "command/pose", 1)
    user.wait_until(lambda: paths.get_subscription_count() == poses.get_subscription_count() == 1)

    # What nothing can be made of changes nothing; a point in the ground is left out.
    for wrong in (trajectory([1.0], frame="world"), trajectory([])):
        paths.publish(wrong)
    paths.publish(trajectory([3.0, -3.0, 4.0]))
    user.wait_until(lambda: heights_m(user) == [3, 4])

    paths.publish(trajectory(list(np.linspace(5, 6, 400))))
    user.wait_until(lambda: len(user.received[SAMPLES]) > 2)
    paths.publish(trajectory([7.0, 8.0]))
    user.wait_until(lambda: heights_m(user)[-1] == 8)
    assert len(user.received[SAMPLES]) < 300
    assert heights_m(user)[-2:] == [7, 8]

    paths.publish(trajectory(list(np.linspace(5, 6, 400))))
    user.wait_until(lambda: heights_m(user)[-1] < 7)
    poses.publish(stamped(down(9)))
    user.wait_until(lambda: heights_m(user)[-1] == 9)
    assert len(user.received[SAMPLES]) < 600
