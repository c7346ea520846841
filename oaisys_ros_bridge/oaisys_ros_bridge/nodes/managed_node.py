"""A lifecycle node that returns by itself to the state that it is meant to be in.

`rclpy.lifecycle` only makes transitions that somebody requests, drops the errors of their
callbacks, and raises where a state has no such transition.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable

from lifecycle_msgs.msg import State
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState
from rclpy.lifecycle.node import TransitionCallbackReturn
from rclpy.node import Node

from oaisys_core.errors import OaisysError
from oaisys_ros_bridge.private.lifecycle import current_state, refuse_wrong_transitions

UNCONFIGURED: int = State.PRIMARY_STATE_UNCONFIGURED
INACTIVE: int = State.PRIMARY_STATE_INACTIVE
ACTIVE: int = State.PRIMARY_STATE_ACTIVE
FINALIZED: int = State.PRIMARY_STATE_FINALIZED
NAMES = {
    UNCONFIGURED: "unconfigured",
    INACTIVE: "inactive",
    ACTIVE: "active",
    FINALIZED: "finalized",
}
"""Names of the primary states."""


class ManagedNode(LifecycleNodeMixin, Node):
    """Has a state, and an aim: the primary state that it was last told to be in.

    When something that the node needs is lost, the node leaves its state; when that is back, the
    node returns to its aim, one transition at a time. A transition that somebody else requests also
    changes the aim.

    Nodes override `configure`, `activate`, `deactivate`, `cleanup` and `reachable`. All of these
    run one at a time, in a callback group of their own.

    Attributes:
        by_itself: Whether the transition under way is the node's own; if not, it was requested.
    """

    def __init__(self, name: str) -> None:
        """Start unconfigured, with that as the aim."""
        group = MutuallyExclusiveCallbackGroup()
        Node.__init__(self, name)
        LifecycleNodeMixin.__init__(self, callback_group=group)
        self._aim = UNCONFIGURED
        self._known = UNCONFIGURED, NAMES[UNCONFIGURED]
        self.by_itself = False
        self._failure = ""
        self._wake_up = self.create_guard_condition(self._settle, callback_group=group)
        refuse_wrong_transitions(self, self._report_wrong_transition, self.settle)

    def configure(self) -> None:
        """Prepare to work; raise `OaisysError` if that is impossible now."""

    def activate(self) -> None:
        """Start to work; raise `OaisysError` if that is impossible now."""

    def deactivate(self) -> None:
        """Stop working."""

    def cleanup(self) -> None:
        """Release what `configure` acquired."""

    def on_settled(self) -> None:
        """Called after the state may have changed."""

    def reachable(self) -> int:
        """Return the highest primary state that is possible now."""
        return ACTIVE

    @property
    def state(self) -> int:
        """Id of the current primary or transition state."""
        return current_state(self, self._known)[0]

    @property
    def state_name(self) -> str:
        """The state's name, such as ``inactive``."""
        return current_state(self, self._known)[1]

    @property
    def aim(self) -> int:
        """Id of the primary state that the node was last told to be in."""
        return self._aim

    def set_aim(self, state: int) -> None:
        """Set the aim; go there as soon as it can be reached."""
        self._aim = state
        self.settle()

    def settle(self) -> None:
        """Check, soon and on another thread, whether another state is possible or necessary."""
        self._wake_up.trigger()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Prepare to work."""
        return self._transition(self.configure, INACTIVE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to work."""
        return self._transition(self.activate, ACTIVE)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        return self._transition(self.deactivate, INACTIVE)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything."""
        return self._transition(self.cleanup, UNCONFIGURED)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working and release everything, for good."""
        return self._transition(lambda: self._end(state), FINALIZED)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything after a transition that raised; it can be configured again."""
        self._aim = UNCONFIGURED
        self.by_itself = False
        return self._transition(lambda: self._end(state), UNCONFIGURED)

    def _end(self, state: LifecycleState) -> None:
        if state.state_id == ACTIVE:
            self.deactivate()
        if state.state_id != UNCONFIGURED or self._aim != UNCONFIGURED:
            self.cleanup()

    def _transition(self, work: Callable[[], object], aim: int) -> TransitionCallbackReturn:
        """Do the work of a transition and log its errors, which rclpy drops."""
        try:
            work()
        except OaisysError as error:
            if str(error) != self._failure:
                self.get_logger().warning(f"the transition failed: {error}")
            self._failure = str(error) if self.by_itself else ""
            return TransitionCallbackReturn.FAILURE
        except Exception:  # noqa: BLE001 - rclpy would drop any error silently
            self.get_logger().error(f"the transition broke:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR
        if not self.by_itself:
            self._aim = aim
        self._known = aim, NAMES[aim]
        return TransitionCallbackReturn.SUCCESS

    def _settle(self) -> None:
        """Make transitions towards the aim, as far as is possible now."""
        self.by_itself = True
        try:
            while self.state in (UNCONFIGURED, INACTIVE, ACTIVE):
                step = self._step_to(min(self._aim, self.reachable()))
                if step is None or step() != TransitionCallbackReturn.SUCCESS:
                    break
        finally:
            self.by_itself = False
            self.on_settled()

    def _step_to(self, goal: int) -> Callable[[], TransitionCallbackReturn] | None:
        step: Callable[[], TransitionCallbackReturn] | None = None
        if goal > self.state:
            step = self.trigger_configure if self.state == UNCONFIGURED else self.trigger_activate
        elif goal < self.state:
            step = self.trigger_deactivate if self.state == ACTIVE else self.trigger_cleanup
        return step

    def _report_wrong_transition(self, error: str) -> None:
        self.get_logger().warning(f"no such transition now: {error}")
