"""The bridge as other nodes of a ROS graph meet it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.task import Future
from ros_peer import Stage, User, nanoseconds, stamped, wait_until_known
from served_simulator import FLAT_WORLD, Server
from simulation_interfaces.msg import Result
from simulation_interfaces.srv import GetEntities, GetEntitiesStates, GetEntityState
from std_msgs.msg import Bool, Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import SemanticLabels
from oaisys_msgs.srv import SetPose
from oaisys_ros_bridge.qos import (
    DEEP_QOS,
    LATCHED_QOS,
    MAX_WAITING,
    MOTION_QOS,
    SERVICE_QOS,
)

pytestmark = pytest.mark.ros

START_M = (-3.0, 2.0, 7.0)
WORLD = {
    **FLAT_WORLD,
    "sensors": {**FLAT_WORLD["sensors"], "start_pose": {"position_m": list(START_M)}},
}
VOLATILE_QOS = QoSProfile(depth=100)
"""As planners subscribe to odometry."""
BY_HAND = Pose((0.0, 0.0, 5.0), (0.0, 0.38, 0.0, 0.93))
TOO_LONG = Pose((0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.02))


@pytest.fixture(scope="module")
def server(shared_stage: Stage) -> Server:
    """With a flat world."""
    return shared_stage.start_world(WORLD)


@pytest.fixture(scope="module")
def graph(shared_stage: Stage, server: Server) -> User:
    """A user who hears the motion of a bridge."""
    user = shared_stage.user
    shared_stage.start_bridge(server.address)
    user.wait_until_ready()
    return user


@pytest.fixture(scope="module")
def simulated(graph: User, shared_stage: Stage, server: Server) -> User:
    """That user, beside a second bridge, of the namespace ``mars``, which is the clock."""
    for topic, kind, qos in (
        ("/diagnostics", DiagnosticArray, DEEP_QOS),
        ("/mars/camera/semantic_0/labels", SemanticLabels, LATCHED_QOS),
        ("/mars/oaisys_bridge/ready", Bool, LATCHED_QOS),
        ("/mars/tf_static", TFMessage, LATCHED_QOS),
    ):
        graph.listen(kind, topic, qos)
    options = ["-r", "__ns:=/mars", "-r", "/tf:=tf", "-r", "/tf_static:=tf_static"]
    options += ["-p", "publish_clock:=true", "-p", f"address:={server.address}"]
    shared_stage.start_node("bridge", "--ros-args", *options)
    states = graph.received["/mars/oaisys_bridge/ready"]
    graph.wait_until(lambda: states and states[-1].data)
    return graph


def position_m(place: Any) -> tuple[float, float, float]:
    """Of a pose or a transform."""
    p = place.position if hasattr(place, "position") else place.translation
    return (p.x, p.y, p.z)


def told_m(user: User, odometry: str, tf: str) -> set[tuple[float, float, float]]:
    """Where a late reader hears the rig to be, on topics that it reads from now on."""
    for topic, kind in ((odometry, Odometry), (tf, TFMessage)):
        user.listen(kind, topic, VOLATILE_QOS)
    user.wait_until(lambda: user.received[odometry] and user.received[tf])
    places = [message.pose.pose for message in user.received[odometry]]
    places += [t.transform for message in user.received[tf] for t in message.transforms]
    return set(map(position_m, places))


def state_m(user: User, bridge: str) -> tuple[float, float, float]:
    """Where the rig is as an entity."""
    client = user.client(GetEntityState, f"{bridge}/get_entity_state")
    answer = user.answer(client.call_async(GetEntityState.Request(entity="base_link")))
    assert answer.result.result == Result.RESULT_OK, answer.result.error_message
    return position_m(answer.state.pose)


def test_the_rig_is_at_its_start_pose_before_the_first_view(graph: User) -> None:
    heard = told_m(graph, "ground_truth/odometry", "/tf") | told_m(graph, "odometry", "/tf")

    assert heard == {START_M}
    assert state_m(graph, "oaisys_bridge") == START_M
    for message in graph.received["odometry"]:
        assert (message.header.frame_id, message.child_frame_id) == ("map", "base_link")
    # It goes on, as transforms do.
    before = len(graph.received["odometry"])
    graph.wait_until(lambda: len(graph.received["odometry"]) > before + 2)
    stamps = [nanoseconds(message.header.stamp) for message in graph.received["odometry"]]
    assert stamps == sorted(set(stamps))


def test_readers_that_come_between_two_views_hear_where_the_rig_is(simulated: User) -> None:
    place = pose_looking_down(1.0, 2.0, 6.0)
    assert call_mars(simulated, SetPose, "set_pose", pose=stamped(place)).success
    assert simulated.set_pose(place).success

    assert told_m(simulated, "odometry", "/tf") == {place.position_m}
    # This bridge is the clock, which stands still: it tells new readers.
    assert told_m(simulated, "/mars/odometry", "/mars/tf") == {place.position_m}
    heard = simulated.received["/mars/odometry"]
    newest_ns = max(nanoseconds(message.header.stamp) for message in heard)
    assert told_m(simulated, "/mars/ground_truth/odometry", "/mars/tf") == {place.position_m}
    assert max(nanoseconds(message.header.stamp) for message in heard) - newest_ns < 1000


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
    for topic, kind in (("odometry", Odometry), ("/tf", TFMessage)):
        graph.listen(kind, topic, MOTION_QOS)
    graph.wait_until_matched(["/odometry", "/tf"])
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


SAMPLES, STEP_NS = 3, 10**8
"""With each sample, the second bridge's time goes on by its ``clock_step_s``."""


def call_mars(user: User, kind: type[Any], name: str, **fields: Any) -> Any:
    client = user.client(kind, f"/mars/oaisys_bridge/{name}")
    return user.answer(client.call_async(kind.Request(**fields)))


def test_the_bridges_own_time_is_in_every_header(simulated: User) -> None:
    pose = stamped(BY_HAND)
    for _ in range(SAMPLES):
        newest = call_mars(simulated, SetPose, "set_pose", pose=pose)
    newest_ns = nanoseconds(newest.stamp)
    assert SAMPLES * STEP_NS <= newest_ns < 100 * STEP_NS

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


def call_at_once(user: User, kind: type[Any], name: str, request: Any, count: int) -> list[Future]:
    """Call a service of the bridge many times before any answer is taken."""
    client = user.node.create_client(kind, f"oaisys_bridge/{name}", qos_profile=SERVICE_QOS)
    user.wait_until(client.service_is_ready)
    wait_until_known(user.node, "oaisys_bridge", user.wait_until)
    return [client.call_async(request) for _ in range(count)]


def answers_of(user: User, futures: list[Future]) -> list[Any]:
    user.wait_until(lambda: all(future.done() for future in futures))
    return [future.result() for future in futures]


DEPTH_ALONE = SetPose.Request(pose=stamped(BY_HAND), modalities=["depth"])


@pytest.mark.parametrize("count", [12, 40])
def test_calls_at_once_are_all_answered_in_their_order(graph: User, count: int) -> None:
    answers = answers_of(graph, call_at_once(graph, SetPose, "set_pose", DEPTH_ALONE, count))

    assert all(answer.success for answer in answers)
    ids = [answer.sample_id for answer in answers]
    assert ids == list(range(ids[0], ids[0] + count))


@pytest.mark.long
def test_of_too_many_calls_the_last_are_refused_in_words(graph: User, server: Server) -> None:
    count, allowed = MAX_WAITING + 20, 1 + MAX_WAITING
    worker = server.worker()
    worker.suspend()
    try:
        views = call_at_once(graph, SetPose, "set_pose", DEPTH_ALONE, count)
        lists = call_at_once(graph, GetEntities, "get_entities", GetEntities.Request(), count)
        refused = [answers_of(graph, futures[allowed:]) for futures in (views, lists)]
    finally:
        worker.resume()

    told = {answer.message for answer in refused[0]}
    told |= {answer.result.error_message for answer in refused[1]}
    assert len(told) == 1
    assert told.pop().startswith(f"too many requests: {MAX_WAITING} wait for this service")
    assert all(answer.success for answer in answers_of(graph, views[:allowed]))
    found = answers_of(graph, lists[:allowed])
    assert {answer.result.result for answer in found} == {Result.RESULT_OK}
