"""The bridge through its server's deaths and its own."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_peer import Stage, User, nanoseconds, stamped
from served_simulator import FLAT_WORLD, free_address
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from waiting import PATIENCE_S, SHUTDOWN_S, within

from oaisys_core.errors import DeadlineExceededError
from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.experiments import status
from oaisys_ros_bridge.experiments.planner_client import PlannerClient
from oaisys_ros_bridge.qos import DEEP_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros


TIMEOUT_S = 4.0
"""Of the requests of a bridge that is to give up."""


def said(diagnostics: DiagnosticArray) -> dict[str, str]:
    """Return what a bridge's status holds, by name."""
    return {value.key: value.value for value in diagnostics.status[0].values}


def change(user: User, *transitions: int) -> None:
    """Lead the bridge through transitions of its life cycle."""
    for transition in transitions:
        request = ChangeState.Request(transition=Transition(id=transition))
        assert user.call(ChangeState, "change_state", request).success


def test_the_bridge_waits_for_a_server_and_outlives_it(stage: Stage) -> None:
    user = stage.user
    address = free_address()
    user.listen(DiagnosticArray, "/diagnostics", SENSOR_QOS)
    bridge = stage.start_bridge(address)
    user.wait_until_ready(False)
    assert not user.set_pose(pose_looking_down(0, 0, 5)).success
    diagnostics = user.received["/diagnostics"]
    user.wait_until(lambda: diagnostics and diagnostics[-1].status[0].level == b"\x02")

    first = stage.start_world(FLAT_WORLD, "--address", address)
    user.wait_until_ready()
    assert user.set_pose(pose_looking_down(0, 0, 5)).success
    user.wait_until(lambda: diagnostics[-1].status[0].level == b"\x00")
    diagnostics.clear()
    first.process.kill()
    user.wait_until_ready(False)
    user.wait_until(lambda: diagnostics and diagnostics[-1].status[0].level == b"\x02")
    stage.start_world(FLAT_WORLD, "--address", address)
    user.wait_until_ready()

    asked_s = time.monotonic()
    answer = user.set_pose(pose_looking_down(0, 0, 5))
    answered_s = time.monotonic() - asked_s
    assert answer.success
    stamp_ns = str(nanoseconds(answer.stamp))
    user.wait_until(lambda: said(diagnostics[-1]).get("last_stamp_ns") == stamp_ns)
    user.wait_until(lambda: diagnostics[-1].status[0].level == b"\x00")
    spent = said(diagnostics[-1])
    parts_s = [float(spent[f"last_{part}_s"]) for part in ("render", "transfer", "publish")]
    assert min(parts_s) >= 0
    assert 0 < sum(parts_s) <= answered_s + 1e-3
    ended = user.call(Trigger, "end_simulation", Trigger.Request())
    assert ended.success, ended.message
    user.wait_until_ready(False)
    assert bridge.end() == 0
    assert "Traceback" not in bridge.log.read_text()


def test_a_request_waits_while_the_worker_is_started_again(stage: Stage) -> None:
    user, pose = stage.user, pose_looking_down(0, 0, 5)
    user.listen(SampleInfo, "oaisys_bridge/sample_info", DEEP_QOS)
    server = stage.start_world(FLAT_WORLD)
    stage.start_bridge(server.address)
    user.wait_until_ready()
    sweep = user.action_client(Sweep, "oaisys_bridge/sweep")
    poses = PoseArray(header=Header(frame_id="map"), poses=[stamped(pose).pose] * 1_000)
    goal = user.answer(sweep.send_goal_async(Sweep.Goal(poses=poses)))
    samples = user.received["oaisys_bridge/sample_info"]
    user.wait_until(samples.__len__)
    server.worker().kill()
    user.wait_until_ready(False)

    answer = user.set_pose(pose)

    assert answer.success, answer.message
    assert not user.answer(goal.get_result_async()).result.success
    user.wait_until_ready()
    change(user, Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    timeout = Parameter("timeout_s", value=TIMEOUT_S).to_parameter_msg()
    request = SetParameters.Request(parameters=[timeout])
    assert user.call(SetParameters, "set_parameters", request).results[0].successful
    change(user, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    user.wait_until_ready()
    first = server.worker()
    first.kill()
    user.wait_until(lambda: server.worker().pid != first.pid)
    worker = server.worker()
    worker.suspend()
    user.wait_until_ready(False)
    asked_s = time.monotonic()
    answer = user.set_pose(pose)
    assert not answer.success
    assert "is starting its worker, and was not ready within 4 s" in answer.message
    assert time.monotonic() - asked_s >= TIMEOUT_S
    worker.resume()
    user.wait_until_ready()
    assert user.set_pose(pose).success


@pytest.mark.long
def test_signals_end_it_in_peace_even_while_it_renders(stage: Stage) -> None:
    server = stage.start_world(
        {**FLAT_WORLD, "stage": {"surroundings": "plain", "extent_m": 40, "resolution_px": 513}}
    )
    bridge = stage.start_bridge(server.address)
    stage.user.wait_until(lambda: "first batch" in bridge.log.read_text())

    with within(SHUTDOWN_S):
        assert bridge.end(signal.SIGTERM) == 0  # other tests end it with SIGINT
    assert "Traceback" not in bridge.log.read_text()


@pytest.mark.long
def test_a_first_batch_that_fails_is_built_once_more(stage: Stage, tmp_path: Path) -> None:
    user = stage.user
    crash = f"batch-crash-once:{tmp_path / 'crashed'}"
    address = free_address()
    user.listen(DiagnosticArray, "/diagnostics", DEEP_QOS)
    diagnostics = user.received["/diagnostics"]

    def message(text: str) -> bool:
        return any(text in status.message for array in diagnostics for status in array.status)

    bridge = stage.start_bridge(address)
    user.wait_until(lambda: diagnostics)  # what it says from now on is not missed
    stage.start_world(FLAT_WORLD, "--address", address, OAISYS_TEST_BUILD="1", OAISYS_FAULT=crash)
    user.wait_until(lambda: message("the first batch failed and is built once more: "))
    assert message("the worker was ended by SIGABRT")
    user.wait_until_ready()
    assert said(diagnostics[-1])["first_batch_error"] == ""
    assert "SIGABRT" in said(diagnostics[-1])["first_batch_retried_after"]
    assert user.set_pose(pose_looking_down(0, 0, 5)).success
    assert "built once more" in bridge.log.read_text()


@pytest.mark.long
def test_a_second_bridge_of_that_name_ends_a_survey_before_it_begins_and_before_its_next_view(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, ros_domain_id: int
) -> None:
    address = stage.start_world(FLAT_WORLD).address
    stage.start_bridge(address)
    monkeypatch.setattr(status, "DISCOVERY_TIMEOUT_S", 2.0)
    expected = rf"bridges but ours to leave ROS domain {ros_domain_id}"
    with PlannerClient("camera", ("depth",)) as client:
        client.status.wait_for_bridge(PATIENCE_S, lambda: None)
        stage.start_bridge(address)
        stage.user.wait_until(lambda: client.status.bridges == 2)
        with pytest.raises(DeadlineExceededError, match=expected):
            client.status.wait_for_bridge(PATIENCE_S, lambda: None)
        pose = pose_looking_down(0, 0, 5)
        with pytest.raises(DeadlineExceededError, match=expected):
            client.view(pose, "", "map", PATIENCE_S)
        with pytest.raises(DeadlineExceededError, match=expected):
            client.sweep([pose], "map", PATIENCE_S)
