"""The bridge as other nodes of a ROS graph meet it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry
from ros_peer import Stage, User, nanoseconds, stamped
from served_simulator import FLAT_WORLD
from simulation_interfaces.srv import GetEntitiesStates, GetEntityState
from std_msgs.msg import Bool, Header
from tf2_msgs.msg import TFMessage

from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import SemanticLabels
from oaisys_msgs.srv import SetPose
from oaisys_ros_bridge.qos import DEEP_QOS, LATCHED_QOS, MOTION_QOS, TF_QOS

pytestmark = pytest.mark.ros

BY_HAND = Pose((0.0, 0.0, 5.0), (0.0, 0.38, 0.0, 0.93))
TOO_LONG = Pose((0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.02))


@pytest.fixture(scope="module")
def address(shared_stage: Stage) -> str:
    """Of a simulator with a flat world."""
    return shared_stage.start_world(FLAT_WORLD).address


@pytest.fixture(scope="module")
def graph(shared_stage: Stage, address: str) -> User:
    """A user who hears the motion of a bridge."""
    user = shared_stage.user
    for topic in ("odometry", "ground_truth/odometry"):
        user.listen(Odometry, topic, MOTION_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    shared_stage.start_bridge(address)
    user.wait_until_ready()
    return user


@pytest.fixture(scope="module")
def simulated(graph: User, shared_stage: Stage, address: str) -> User:
    """That user, beside a second bridge, of the namespace ``mars``, which is the clock."""
    for topic, kind, qos in (
        ("/diagnostics", DiagnosticArray, DEEP_QOS),
        ("/mars/camera/semantic_0/labels", SemanticLabels, LATCHED_QOS),
        ("/mars/oaisys_bridge/ready", Bool, LATCHED_QOS),
        ("/mars/tf_static", TFMessage, LATCHED_QOS),
    ):
        graph.listen(kind, topic, qos)
    options = ["-r", "__ns:=/mars", "-r", "/tf:=tf", "-r", "/tf_static:=tf_static"]
    options += ["-p", "publish_clock:=true", "-p", f"address:={address}"]
    shared_stage.start_node("bridge", "--ros-args", *options)
    states = graph.received["/mars/oaisys_bridge/ready"]
    graph.wait_until(lambda: states and states[-1].data)
    return graph


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


SAMPLES = 3
"""With which the second bridge's time goes on by its ``clock_step_s`` of 0.1 s."""


def call_mars(user: User, kind: type[Any], name: str, **fields: Any) -> Any:
    client = user.client(kind, f"/mars/oaisys_bridge/{name}")
    return user.answer(client.call_async(kind.Request(**fields)))


def test_the_bridges_own_time_is_in_every_header(simulated: User) -> None:
    pose = stamped(BY_HAND)
    for _ in range(SAMPLES):
        newest = call_mars(simulated, SetPose, "set_pose", pose=pose)
    newest_ns = nanoseconds(newest.stamp)
    assert newest_ns == SAMPLES * 10**8

    state = call_mars(simulated, GetEntityState, "get_entity_state", entity="base_link").state
    states = call_mars(simulated, GetEntitiesStates, "get_entities_states").states
    assert {nanoseconds(s.header.stamp) for s in (state, *states)} == {newest_ns}
    simulated.received["/diagnostics"].clear()
    told = simulated.wait_until(
        lambda: [
            nanoseconds(array.header.stamp)
            for array in simulated.received["/diagnostics"]
            if array.status[0].name.startswith("/mars/")
        ]
    )
    assert set(told) == {newest_ns}
    (mounts,) = simulated.received["/mars/tf_static"]
    legend = simulated.received["/mars/camera/semantic_0/labels"][-1]
    for header in (legend.header, *(t.header for t in mounts.transforms)):
        assert nanoseconds(header.stamp) < newest_ns


def test_diagnostics_of_two_bridges_have_different_names(simulated: User) -> None:
    def names() -> set[str]:
        return {s.name for array in simulated.received["/diagnostics"] for s in array.status}

    expected = {
        f"{bridge}: {what}"
        for bridge in ("/oaisys_bridge", "/mars/oaisys_bridge")
        for what in ("simulator", "readers")
    }
    simulated.wait_until(lambda: names() >= expected)
    assert names() == expected
