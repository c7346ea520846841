"""The bridge as a managed node: where it goes by itself, and where it is told to go."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from ros_peer import Stage, User
from served_simulator import FLAT_WORLD, free_address
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import SetSimulationState

from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Pose
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.qos import SENSOR_QOS, SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

EVENTS = "oaisys_bridge/transition_event"
DIAGNOSTICS = "/diagnostics"
UNCONFIGURED, INACTIVE = State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE
ACTIVE, FINALIZED = State.PRIMARY_STATE_ACTIVE, State.PRIMARY_STATE_FINALIZED


class Manager:
    """Asks for transitions, as ``ros2 lifecycle`` does."""

    def __init__(self, user: User) -> None:
        self._user = user
        user.listen(TransitionEvent, EVENTS, SENSOR_QOS)
        user.listen(DiagnosticArray, DIAGNOSTICS, SENSOR_QOS)

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self._user.call(ChangeState, "change_state", request).success)

    def state(self) -> int:
        return int(self._user.call(GetState, "get_state", GetState.Request()).current_state.id)

    def reached(self) -> list[str]:
        """Names of the primary states that it has been in, in order."""
        goals = [event.goal_state for event in self._user.received[EVENTS]]
        return [goal.label for goal in goals if goal.id <= FINALIZED]

    def wait_for_status(self, level: bytes, **values: str) -> DiagnosticStatus:
        """Wait for a report of this level with these values."""

        def found() -> DiagnosticStatus | None:
            for message in self._user.received[DIAGNOSTICS][-2:]:
                status = message.status[0]
                told = {value.key: value.value for value in status.values}
                if status.level == level and told.items() >= values.items():
                    return status
            return None

        return self._user.wait_until(found)


def down() -> Pose:
    return pose_looking_down(0.0, 0.0, 5.0)


def test_it_goes_where_it_is_told(stage: Stage) -> None:
    user, address = stage.user, free_address()
    manager = Manager(user)
    user.listen(SampleInfo, "oaisys_bridge/sample_info", SMALL_MESSAGE_QOS)
    options = ("--ros-args", "-p", f"address:={address}", "-p", "autostart:=false")
    bridge = stage.start_node("bridge", *options)
    assert manager.state() == UNCONFIGURED
    states = user.call(GetAvailableStates, "get_available_states", GetAvailableStates.Request())
    assert {s.label for s in states.available_states} >= {"unconfigured", "inactive", "active"}
    assert not manager.change(Transition.TRANSITION_ACTIVATE), "there is no such transition now"
    assert not manager.change(Transition.TRANSITION_CONFIGURE), "there is no simulator yet"
    assert manager.state() == UNCONFIGURED
    assert "unconfigured" in user.set_pose(down()).message
    manager.wait_for_status(DiagnosticStatus.WARN, lifecycle_state="unconfigured")

    assert stage.start_world(FLAT_WORLD, "--address", address).address == address
    assert manager.change(Transition.TRANSITION_CONFIGURE)
    assert manager.state() == INACTIVE
    answer = user.set_pose(down())
    assert (answer.success, "inactive: activate it" in answer.message) == (False, True)
    assert manager.change(Transition.TRANSITION_ACTIVATE)
    assert manager.state() == ACTIVE
    user.wait_until_ready()
    assert user.set_pose(down()).success
    manager.wait_for_status(DiagnosticStatus.OK, lifecycle_state="active", rendered="1")
    request = GetAvailableTransitions.Request()
    offered = user.call(GetAvailableTransitions, "get_available_transitions", request)
    labels = {t.transition.label for t in offered.available_transitions}
    assert labels == {"deactivate", "shutdown"}

    assert manager.change(Transition.TRANSITION_DEACTIVATE)
    user.wait_until_ready(False)
    assert not user.set_pose(down()).success
    assert manager.change(Transition.TRANSITION_CLEANUP)
    user.wait_until(lambda: user.node.count_publishers("/camera/depth/image_raw") == 0)
    assert manager.change(Transition.TRANSITION_CONFIGURE)
    assert manager.change(Transition.TRANSITION_ACTIVATE)
    user.wait_until_ready()
    assert user.set_pose(down()).sample_id == 2
    user.wait_until(lambda: len(user.received["oaisys_bridge/sample_info"]) == 2)

    assert manager.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    user.wait_until(lambda: bridge.process.poll() is not None)
    assert bridge.process.returncode == 0
    assert manager.reached()[-1] == "finalized"
    assert "Traceback" not in bridge.log.read_text()


@pytest.mark.parametrize(
    "state",
    [
        pytest.param(UNCONFIGURED, marks=pytest.mark.soak),
        pytest.param(INACTIVE, marks=pytest.mark.long),
    ],
)
def test_a_shutdown_ends_the_process_before_it_was_active_too(stage: Stage, state: int) -> None:
    manager = Manager(stage.user)
    address = stage.start_world(FLAT_WORLD).address if state == INACTIVE else free_address()
    options = ("--ros-args", "-p", f"address:={address}", "-p", "autostart:=false")
    bridge = stage.start_node("bridge", *options)
    assert manager.state() == UNCONFIGURED
    shutdown = Transition.TRANSITION_UNCONFIGURED_SHUTDOWN
    if state == INACTIVE:
        assert manager.change(Transition.TRANSITION_CONFIGURE)
        assert manager.state() == INACTIVE
        shutdown = Transition.TRANSITION_INACTIVE_SHUTDOWN
    assert manager.change(shutdown)
    stage.user.wait_until(lambda: bridge.process.poll() is not None)
    assert bridge.process.returncode == 0
    assert "Traceback" not in bridge.log.read_text()


@pytest.mark.long
def test_it_comes_back_to_where_it_was_when_the_simulator_does(stage: Stage) -> None:
    user, address = stage.user, free_address()
    manager = Manager(user)
    bridge = stage.start_bridge(address)
    user.wait_until(lambda: user.received[DIAGNOSTICS])
    manager.wait_for_status(DiagnosticStatus.ERROR, lifecycle_state="unconfigured")
    first = stage.start_world(FLAT_WORLD, "--address", address)
    assert first.address == address
    user.wait_until_ready()
    assert manager.state() == ACTIVE
    status = manager.wait_for_status(DiagnosticStatus.OK, connections="1", renderer="idle")
    told = {value.key: value.value for value in status.values}
    assert {"queue", "dropped_commands", "last_render_s", "worker_restarts"} <= told.keys()
    assert float(told["memory_mb"]) > 10

    paused = SetSimulationState.Request(state=SimulationState(state=SimulationState.STATE_PAUSED))
    assert user.call(SetSimulationState, "set_simulation_state", paused).result.result == 1
    assert "paused" in user.set_pose(down()).message
    first.process.kill()
    user.wait_until_ready(False)
    user.wait_until(lambda: manager.reached()[-1:] == ["unconfigured"])
    assert stage.start_world(FLAT_WORLD, "--address", address).address == address
    user.wait_until_ready()
    assert user.set_pose(down()).success
    manager.wait_for_status(DiagnosticStatus.OK, lifecycle_state="active", connections="2")

    # Somebody who wants it inactive gets that, through the simulator's next death as well.
    assert manager.change(Transition.TRANSITION_DEACTIVATE)
    user.wait_until_ready(False)
    assert manager.state() == INACTIVE
    assert "activate it first" in user.set_pose(down()).message
    assert bridge.end() == 0
    assert "Traceback" not in bridge.log.read_text()
