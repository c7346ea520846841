"""The bridge as other nodes of a ROS graph meet it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry
from ros_peer import Stage, User, stamped
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.qos import MOTION_QOS, TF_QOS

pytestmark = pytest.mark.ros

BY_HAND = Pose((0.0, 0.0, 5.0), (0.0, 0.38, 0.0, 0.93))
TOO_LONG = Pose((0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.02))


@pytest.fixture(scope="module")
def graph(shared_stage: Stage) -> User:
    """A user who hears the motion of a bridge before a flat world."""
    server = shared_stage.start_world(FLAT_WORLD)
    user = shared_stage.user
    for topic in ("odometry", "ground_truth/odometry"):
        user.listen(Odometry, topic, MOTION_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    shared_stage.start_bridge(server.address)
    user.wait_until_ready()
    return user


def orientations(user: User, stamp: Any) -> list[Any]:
    """Wait for odometry and transform of a stamp and return their orientations."""

    def found() -> list[Any]:
        odometry = [m for m in user.received["odometry"] if m.header.stamp == stamp]
        moved = [m.transforms[0] for m in user.received["/tf"]]
        moved = [t for t in moved if t.header.stamp == stamp]
        both = (
            (odometry[-1].pose.pose.orientation, moved[-1].transform.rotation)
            if (odometry and moved)
            else ()
        )
        return list(both)

    both: list[Any] = user.wait_until(found)
    return both


def test_quaternions_typed_by_hand_are_normalised_in_every_message(graph: User) -> None:
    answer = graph.set_pose(BY_HAND)

    assert answer.success, answer.message
    for q in orientations(graph, answer.stamp):
        assert np.linalg.norm([q.x, q.y, q.z, q.w]) == pytest.approx(1.0, abs=1e-12)
    sweep = graph.action_client(Sweep, "oaisys_bridge/sweep")
    for pose, ends_well in ((BY_HAND, True), (TOO_LONG, False)):
        poses = PoseArray(header=Header(frame_id="map"), poses=[stamped(pose).pose])
        goal = graph.answer(sweep.send_goal_async(Sweep.Goal(poses=poses)))
        result = graph.answer(goal.get_result_async()).result
        assert result.success == ends_well
        assert ends_well or "norm within 0.01 of 1, not 1.02" in result.message
    refused = graph.set_pose(TOO_LONG)
    assert (refused.success, refused.sample_id) == (False, 0)
    assert "pose.pose.orientation: received [0.0, 0.0, 0.0, 1.02]" in refused.message
