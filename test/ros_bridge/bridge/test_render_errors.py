"""A render that fails: whoever uses ROS reads the simulator's sentence, wherever they look."""

from __future__ import annotations

import time
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseArray, PoseStamped
from ros_peer import NodeProcess, Stage, User, stamped
from served_simulator import FLAT_WORLD
from waiting import PATIENCE_S

from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    OaisysError,
    QueueFullError,
    RenderError,
    WorkerLostError,
)
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata
from oaisys_msgs.action import Sweep
from oaisys_msgs.srv import SetMetadata, SetPose, StepBatch
from oaisys_ros_bridge.bridge.metadata import PendingMetadata
from oaisys_ros_bridge.qos import NEWEST_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

SENTENCE = "Cycles: out of SVM stack space; the shader of the ground is too big"
SEVERAL_ATTEMPTS_S = 3.0
"""For many more attempts than are expected, if nothing slows them down."""


def start(stage: Stage, fault: str) -> NodeProcess:
    stage.user.listen(DiagnosticArray, "/diagnostics", SENSOR_QOS)
    server = stage.start_world(FLAT_WORLD, OAISYS_TEST_BUILD="1", OAISYS_FAULT=fault)
    return stage.start_bridge(server.address)


def last_status(user: User) -> DiagnosticStatus:
    return user.received["/diagnostics"][-1].status[0]


def value_of(status: DiagnosticStatus, key: str) -> str:
    return next(v.value for v in status.values if v.key == key)


def sweep(user: User, pose: PoseStamped) -> Any:
    client = user.action_client(Sweep, "oaisys_bridge/sweep")
    poses = PoseArray(header=pose.header, poses=[pose.pose])
    goal = user.answer(client.send_goal_async(Sweep.Goal(poses=poses)))
    return user.answer(goal.get_result_async()).result


def test_a_view_that_fails_says_why_to_whoever_asked(stage: Stage) -> None:
    user, pose = stage.user, stamped(pose_looking_down(0.0, 0.0, 5.0))
    bridge = start(stage, f"fail:{SENTENCE}")
    user.wait_until_ready()

    answer = user.call(SetPose, "set_pose", SetPose.Request(pose=pose))
    assert (answer.success, answer.message) == (False, SENTENCE)
    command = user.node.create_publisher(PoseStamped, "command/pose", NEWEST_QOS)
    user.wait_until(command.get_subscription_count)
    command.publish(pose)
    user.wait_until(lambda: f"command failed: {SENTENCE}" in bridge.log.read_text())
    assert SENTENCE in sweep(user, pose).message
    user.wait_until(lambda: value_of(last_status(user), "failed") == "3")

    assert SENTENCE in value_of(last_status(user), "last_failure")
    assert f"set_pose failed: {SENTENCE}" in bridge.log.read_text()
    assert "refused" not in bridge.log.read_text()  # nothing is wrong with the requests


@pytest.mark.long
def test_metadata_with_which_no_sample_can_be_rendered_is_dropped_in_words(stage: Stage) -> None:
    user, pose = stage.user, stamped(pose_looking_down(0.0, 0.0, 5.0))
    start(stage, f"late-fail:{SENTENCE}@1")
    user.wait_until_ready()
    noon = SetMetadata.Request(module="environment", metadata_json='{"sun_elevation_deg": 60.0}')

    # After depth and labels were published.
    assert user.call(SetMetadata, "set_metadata", noon).success
    message = user.call(SetPose, "set_pose", SetPose.Request(pose=pose)).message
    assert SENTENCE in message
    assert "metadata of environment that waited for this sample was dropped" in message
    answer = user.call(SetPose, "set_pose", SetPose.Request(pose=pose))
    assert (answer.success, answer.message.count("dropped")) == (True, 0)


def test_metadata_is_lent_again_only_as_long_as_it_may_be_blameless() -> None:
    pending, dusk = PendingMetadata(), ModuleMetadata(environment={"sun_elevation_deg": 1.0})

    def fail(error: OaisysError) -> str:
        with pytest.raises(type(error)) as raised:
            lend(dusk, error)
        return str(raised.value)

    def lend(expected: ModuleMetadata, error: OaisysError) -> None:
        with pending.lend() as lent:
            assert lent is not None
            assert lent.environment == expected.environment
            raise error

    def is_pending() -> bool:
        with pending.lend() as lent:
            return lent is not None

    pending.add(dusk)
    for harmless in (CancelledError("c"), QueueFullError("q"), DeadlineExceededError("d")):
        assert fail(harmless) == str(harmless)
    assert fail(InvalidInputError("sensor.pose", 1, "another pose")).endswith("another pose")
    assert fail(WorkerLostError("killed")) == "killed"
    assert fail(WorkerLostError("killed")).startswith("killed; the metadata of environment")
    assert not is_pending()

    pending.add(dusk)
    assert "was dropped" in fail(RenderError("black"))
    assert not is_pending()


@pytest.mark.parametrize(
    ("field", "stays"),
    [
        ("request", False),
        ("metadata.custom.poses", False),
        ("metadata.sensor.pose_policy", False),
        ("metadata.asset.objects.box.pose", False),
        ("metadata.environment.sky", False),
        ("metadata.sensor.pose", True),
        ("metadata.sensor.pose.position_m", True),
        ("pose.position", True),
        ("sensors", True),
    ],
)
def test_metadata_that_was_refused_itself_does_not_wait_for_the_next_sample(
    field: str, stays: bool
) -> None:
    pending = PendingMetadata()
    pending.add(ModuleMetadata(custom={"a": 1}))
    with pytest.raises(InvalidInputError), pending.lend():
        raise InvalidInputError(field, 1, "another value")
    with pending.lend() as lent:
        assert (lent is not None) == stays


def test_metadata_that_no_request_can_hold_is_refused_when_it_is_set() -> None:
    pending, small = PendingMetadata(), ModuleMetadata(environment={"sun_elevation_deg": 1.0})
    pending.add(small)
    many = {f"k{i}": 1 for i in range(200_000)}
    deep: dict[str, Any] = {}
    for _ in range(44):
        deep = {"a": deep}
    for module, values in (("custom", many), ("environment", deep), ("sensor", deep)):
        with pytest.raises(InvalidInputError, match=rf"metadata\.{module}.*at most"):
            pending.add(ModuleMetadata(**{module: values}))
    # Each fits, but not both.
    pending.add(ModuleMetadata(custom={"a": "x" * 2_000_000}))
    with pytest.raises(InvalidInputError, match=r"bytes as a message.*all modules together"):
        pending.add(ModuleMetadata(custom={"b": "x" * 2_000_000}))
    with pending.lend() as lent:
        assert lent is not None
        assert lent.environment == small.environment
        assert list(lent.custom) == ["a"]


@pytest.mark.long
def test_a_first_batch_that_cannot_be_built_says_why_and_is_not_tried_all_the_time(
    stage: Stage,
) -> None:
    user, pose = stage.user, stamped(pose_looking_down(0.0, 0.0, 5.0))
    bridge = start(stage, f"batch-fail:{SENTENCE}")
    expected = f"the first batch could not be built, twice: {SENTENCE}"
    user.wait_until(
        lambda: user.received["/diagnostics"] and last_status(user).message == expected, PATIENCE_S
    )
    end_s = time.monotonic() + SEVERAL_ATTEMPTS_S
    user.wait_until(lambda: time.monotonic() > end_s)

    assert last_status(user).level == DiagnosticStatus.ERROR
    assert user.call(SetPose, "set_pose", SetPose.Request(pose=pose)).message == expected
    assert user.call(StepBatch, "step_batch", StepBatch.Request(seed=-1)).message == SENTENCE
    log = bridge.log.read_text()
    assert log.count("is being built") < 6  # it was four a second
    assert "simulator lost" not in log
