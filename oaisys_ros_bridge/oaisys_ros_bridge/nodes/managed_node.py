"""A managed node that goes by itself where it is meant to be, as soon as it can."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.msg import State
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState
from rclpy.lifecycle.node import TransitionCallbackReturn
from rclpy.node import Node

from oaisys_core.errors import OaisysError

UNCONFIGURED: int = State.PRIMARY_STATE_UNCONFIGURED
INACTIVE: int = State.PRIMARY_STATE_INACTIVE
ACTIVE: int = State.PRIMARY_STATE_ACTIVE
FINALIZED: int = State.PRIMARY_STATE_FINALIZED


class ManagedNode(LifecycleNodeMixin, Node):
    """Has a state, and an aim: the state that it was last told to be in.

    What it needs may go away and come back. It then leaves its state and comes back to it by
    itself, one transition at a time; somebody else's transitions change the aim as well.

    Nodes override `configure`, `activate`, `deactivate`, `cleanup` and `reachable`. All of these
    run one at a time, in a callback group of their own.
    """

    def __init__(self, name: str) -> None:
        """Begin unconfigured, with that as the aim."""
        group = MutuallyExclusiveCallbackGroup()
        Node.__init__(self, name)
        LifecycleNodeMixin.__init__(self, callback_group=group)
        self._aim = UNCONFIGURED
        self._by_itself = False
        self._failure = ""
        self._moved = threading.Condition()
        self._wish = self.create_guard_condition(self._settle, callback_group=group)
        self._survive_wrong_transitions()

    def configure(self) -> None:
        """Get ready; raise `OaisysError` where that is not possible now."""

    def activate(self) -> None:
        """Begin to work; raise `OaisysError` where that is not possible now."""

    def deactivate(self) -> None:
        """Stop working."""

    def cleanup(self, *, for_good: bool) -> None:
        """Let go of what `configure` got; ``for_good``: it was not only lost."""

    def on_settled(self) -> None:
        """Notice that it may be in another state."""

    def reachable(self) -> int:
        """Return the highest state that it could be in now."""
        return ACTIVE

    @property
    def state(self) -> int:
        """The id of the primary state, or of the transition state, that it is in."""
        return int(self._state_machine.current_state[0])

    @property
    def state_name(self) -> str:
        """The state's name, such as ``inactive``."""
        return str(self._state_machine.current_state[1])

    @property
    def aim(self) -> int:
        """The state that it was last told to be in."""
        return self._aim

    def set_aim(self, state: int) -> None:
        """Go to a state as soon as it can be reached."""
        self._aim = state
        self.settle()

    def settle(self) -> None:
        """Look, soon and on another thread, whether another state is possible or necessary now."""
        self._wish.trigger()

    def wait_for(self, state: int, timeout_s: float) -> bool:
        """Return whether it gets into a state in time."""
        with self._moved:
            return self._moved.wait_for(lambda: self.state == state, timeout_s)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Get ready."""
        return self._transition(self.configure, INACTIVE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        return self._transition(self.activate, ACTIVE)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        return self._transition(self.deactivate, INACTIVE)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything."""
        for_good = not self._by_itself
        return self._transition(lambda: self.cleanup(for_good=for_good), UNCONFIGURED)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working, let go of everything, for ever."""
        return self._transition(lambda: self._end(state), FINALIZED)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything after a transition that broke; it can be configured again."""
        self._aim = UNCONFIGURED
        self._by_itself = False
        return self._transition(lambda: self._end(state), UNCONFIGURED)

    def _end(self, state: LifecycleState) -> None:
        if state.state_id == ACTIVE:
            self.deactivate()
        if state.state_id != UNCONFIGURED or self._aim != UNCONFIGURED:
            self.cleanup(for_good=True)

    def _transition(self, work: Callable[[], object], aim: int) -> TransitionCallbackReturn:
        """Do a transition's work; rclpy itself would not tell of an error."""
        try:
            work()
        except OaisysError as error:
            if str(error) != self._failure:
                self.get_logger().warning(f"the transition failed: {error}")
            self._failure = str(error) if self._by_itself else ""
            return TransitionCallbackReturn.FAILURE
        except Exception:  # noqa: BLE001 - whatever broke: rclpy would drop it silently
            self.get_logger().error(f"the transition broke:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        if not self._by_itself:
            self._aim = aim
        return TransitionCallbackReturn.SUCCESS

    def _settle(self) -> None:
        """Go towards the aim, as far as that is possible now."""
        self._by_itself = True
        try:
            while self.state in (UNCONFIGURED, INACTIVE, ACTIVE):
                step = self._step_to(min(self._aim, self.reachable()))
                if step is None or step() != TransitionCallbackReturn.SUCCESS:
                    break
        finally:
            self._by_itself = False
            with self._moved:
                self._moved.notify_all()
            self.on_settled()

    def _step_to(self, goal: int) -> Callable[[], TransitionCallbackReturn] | None:
        step: Callable[[], TransitionCallbackReturn] | None = None
        if goal > self.state:
            step = self.trigger_configure if self.state == UNCONFIGURED else self.trigger_activate
        elif goal < self.state:
            step = self.trigger_deactivate if self.state == ACTIVE else self.trigger_cleanup
        return step

    def _survive_wrong_transitions(self) -> None:
        """Answer a request for a transition that the state does not have; rclpy (7.1) raises."""
        service: Any = self._service_change_state
        inner = service.callback

        def on_change_state(request: Any, response: Any) -> Any:
            try:
                response = inner(request, response)
            except RuntimeError as error:
                self.get_logger().warning(f"no such transition now: {error}")
                response.success = False
            self.settle()
            return response

        service.callback = on_change_state
