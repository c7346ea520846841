"""Messages that nobody means well: refused with the bound, counted, and the bridge goes on."""

from __future__ import annotations

import json
import time
from typing import Any

import psutil
import pytest
from geometry_msgs.msg import Pose as PoseMsg
from geometry_msgs.msg import PoseArray, PoseStamped, Transform
from ros_peer import NodeProcess, Stage, stamped
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from waiting import START_PATIENCE_S

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_at
from oaisys_msgs.action import Sweep
from oaisys_msgs.srv import SetMetadata, StepBatch
from oaisys_ros_bridge.bridge.metadata import (
    json_object,
    metadata_of_module,
    metadata_of_modules,
)
from oaisys_ros_bridge.bridge.requests import MAX_POSES

LOOKING = pose_looking_at((-4, -4, 4), (0, 0, 0))
NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324)

KEPT_BYTES_OF_A_POSE = 3 * 56
"""Of some 650 that it takes in Python: in queues of the middleware, serialised."""

HOSTILE_JSON = {
    "nested": "[" * 10_000 + "]" * 10_000,
    "nested objects": '{"a":' * 10_000 + "1" + "}" * 10_000,
    "65 deep": '{"a":' * 65 + "1" + "}" * 65,
    "NaN": '{"sensor": {"x": NaN}}',
    "Infinity": '{"sensor": {"x": -Infinity}}',
    "1e999": '{"sensor": {"x": 1e999}}',
    "digits": '{"sensor": {"x": ' + "9" * 100_000 + "}}",
    "400 digits": '{"sensor": {"x": ' + "9" * 400 + "}}",
    "a key twice": '{"sensor": {"x": 1, "x": 2}}',
    "a module twice": '{"sensor": {}, "sensor": {}}',
    "half a character": '{"sensor": {"x": "\\ud800"}}',
    "a list": "[1, 2]",
    "a number": "1",
    "null": "null",
    "no object": '{"sensor": [1]}',
    "cut": '{"sensor": {',
    "bytes": "\x00\x01\ufffd",
}


@pytest.mark.parametrize("text", HOSTILE_JSON.values(), ids=HOSTILE_JSON)
def test_hostile_json_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        metadata_of_modules(text)
    assert len(str(refused.value)) < 500
    with pytest.raises(InvalidInputError):
        metadata_of_module(
            "sensor", text if text.startswith(("[", "n", "1", "\x00")) else f"[{text}]"
        )


@pytest.mark.parametrize("text", ['"' + "x" * 100_000_000 + '"', "[" + "{}," * 5_000_000 + "{}]"])
def test_json_of_100_mb_is_refused_before_it_is_read(text: str) -> None:
    with pytest.raises(InvalidInputError, match="more than"):
        json_object("metadata_json", text)


@pytest.fixture(scope="module")
def address(shared_stage: Stage) -> str:
    return shared_stage.start_world(FLAT_WORLD).address


@pytest.fixture(scope="module")
def bridge(shared_stage: Stage, address: str) -> NodeProcess:
    """A bridge that all tests have."""
    bridge = shared_stage.start_bridge(address)
    shared_stage.user.wait_until_ready()
    return bridge


def memory_mb(pid: int) -> float:
    return psutil.Process(pid).memory_info().rss / 1e6


def diagnostics(stage: Stage) -> dict[str, str]:
    """Return the newest values of the bridge's status."""
    found: dict[str, str] = {}

    def take(message: Any) -> None:
        for status in message.status:
            if status.name.endswith("simulator"):
                found.update({value.key: value.value for value in status.values})
                found["message"] = status.message

    from diagnostic_msgs.msg import DiagnosticArray

    subscription = stage.user.node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    stage.user.wait_until(lambda: "rendered" in found)
    stage.user.node.destroy_subscription(subscription)
    return found


@pytest.mark.ros
def test_hostile_requests_leave_the_bridge_as_it_was(
    shared_stage: Stage, address: str, bridge: NodeProcess
) -> None:
    user = shared_stage.user
    assert user.set_pose(LOOKING).success
    before_mb = memory_mb(bridge.process.pid)

    for text in HOSTILE_JSON.values():
        for kind, name, fields in (
            (StepBatch, "step_batch", {"seed": -1}),
            (SetMetadata, "set_metadata", {"module": "sensor"}),
        ):
            sent = text.replace("\x00", "\\u0000")
            answer = user.call(kind, name, kind.Request(metadata_json=sent, **fields))
            if answer.success:  # an object: the simulator refuses it at the next sample
                assert kind is SetMetadata
                assert not user.set_pose(LOOKING).success
    assert user.set_pose(LOOKING).success

    # An invalid number at each place of a pose, through each way to request one.
    poses = user.node.create_publisher(PoseStamped, "command/pose", 10)
    ways = user.node.create_publisher(MultiDOFJointTrajectory, "command/trajectory", 10)
    user.wait_until(lambda: poses.get_subscription_count() and ways.get_subscription_count())
    for number in NUMBERS:
        for part, name in (("position", "x"), ("orientation", "w")):
            pose = stamped(LOOKING)
            setattr(getattr(pose.pose, part), name, number)
            poses.publish(pose)
            transform = Transform(rotation=pose.pose.orientation)
            transform.translation.x = pose.pose.position.x
            point = MultiDOFJointTrajectoryPoint(transforms=[transform])
            ways.publish(MultiDOFJointTrajectory(points=[point]))
    assert user.set_pose(LOOKING).success

    # A command every millisecond: the newest wins, the others are counted. On a starved machine,
    # a view may fail, because the bridge has not heard from the simulator for too long.
    published = 1000

    def ended() -> int:
        told = diagnostics(shared_stage)
        return sum(int(told[way]) for way in ("rendered", "dropped_commands", "failed"))

    already = ended()
    for _ in range(published - 1):
        poses.publish(stamped(LOOKING))
        time.sleep(0.001)
    poses.publish(stamped(pose_looking_at((-5, -4, 4), (0, 0, 0))))

    def all_are_accounted_for() -> bool:
        return int(diagnostics(shared_stage)["queue"]) == 0 and ended() - already >= published

    user.wait_until(all_are_accounted_for, explain=lambda: (already, diagnostics(shared_stage)))
    assert memory_mb(bridge.process.pid) < before_mb + 150
    assert user.set_pose(LOOKING).success
    assert "Traceback" not in bridge.log.read_text()

    # Another bridge of this name: told by both, and neither ends.
    other = shared_stage.start_bridge(address)
    user.wait_until(
        lambda: "other nodes have the name /oaisys_bridge" in diagnostics(shared_stage)["message"],
        START_PATIENCE_S,
    )
    assert other.process.poll() is None
    assert bridge.process.poll() is None
    assert "requests may reach any of them" in bridge.log.read_text()
    assert other.end() == 0


@pytest.mark.ros
def test_metadata_that_no_request_can_hold_spoils_no_view(
    shared_stage: Stage, bridge: NodeProcess
) -> None:
    user = shared_stage.user

    many = json.dumps({f"k{i}": 1 for i in range(200_000)})
    for module, text in (
        ("custom", many),
        *(("environment", '{"a":' * depth + "1" + "}" * depth) for depth in (21, 45, 64)),
    ):
        request = SetMetadata.Request(module=module, metadata_json=text)
        answer = user.call(SetMetadata, "set_metadata", request)
        assert not answer.success
        assert answer.message.startswith(f"metadata.{module}")
        assert "at most" in answer.message
        assert user.set_pose(LOOKING).success
    # The simulator refuses it by name at the next sample, and not again.
    policy = SetMetadata.Request(module="sensor", metadata_json='{"pose_policy": "guess"}')
    assert user.call(SetMetadata, "set_metadata", policy).success
    assert "pose_policy" in user.set_pose(LOOKING).message
    assert user.set_pose(LOOKING).success
    assert "Traceback" not in bridge.log.read_text()


@pytest.mark.ros
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(200_000, marks=pytest.mark.long),
        pytest.param(1_000_000, marks=pytest.mark.soak),
    ],
)
def test_a_giant_sweep_is_refused_and_its_memory_given_back(
    shared_stage: Stage, bridge: NodeProcess, number: int
) -> None:
    user = shared_stage.user
    assert user.set_pose(LOOKING).success
    before_mb = memory_mb(bridge.process.pid)
    client = user.action_client(Sweep, "oaisys_bridge/sweep")
    array = PoseArray(header=Header(frame_id="map"), poses=[PoseMsg()] * number)
    goal = user.wait_until(client.send_goal_async(Sweep.Goal(poses=array)).result, START_PATIENCE_S)
    result = user.wait_until(goal.get_result_async().result, START_PATIENCE_S).result
    assert not result.success
    assert f"received '{number} poses', expected at most {MAX_POSES}" in result.message
    # Of the message, the middleware keeps its buffers; the objects that were made of it are gone.
    kept_mb = 60 + number * KEPT_BYTES_OF_A_POSE / 1e6
    user.wait_until(lambda: memory_mb(bridge.process.pid) < before_mb + kept_mb)
    assert user.set_pose(LOOKING).success
