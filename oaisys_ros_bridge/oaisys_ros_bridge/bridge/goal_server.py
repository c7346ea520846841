"""An action that runs one goal at a time and can cancel it in the middle of a render.

`rclpy.action` does neither. Its servers run several goals at a time. A goal learns that it is
cancelled only where it asks; a call to the simulator takes minutes and cannot ask.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from oaisys_core.errors import CancelledError, OaisysError
from oaisys_ros_bridge.bridge.requests import Cancellation
from oaisys_ros_bridge.qos import SERVICE_QOS

CANCELLING_TIMEOUT_S = 1.0
END_TIMEOUT_S = 3.0
CANCELLED = "cancelled"


@dataclass(frozen=True)
class GoalWork:
    """What an action does.

    Attributes:
        kind: The action's type.
        name: Its name.
        run: Executes a goal and fills its result in; raises `OaisysError` if it fails.
        explain: Writes into a result why its goal has failed.
    """

    kind: Any
    name: str
    run: Callable[[ServerGoalHandle, Cancellation, Any], None]
    explain: Callable[[ServerGoalHandle, Any, str], None]


class GoalServer:
    """Runs one goal at a time; another one is aborted, with the reason in its result.

    It is not rejected, as a rejection carries no reason.
    """

    def __init__(self, node: Node, work: GoalWork) -> None:
        self._node = node
        self._work = work
        self._lock = threading.Lock()
        self._running: Cancellation | None = None
        self._accepted: dict[bytes, Cancellation] = {}
        self._idle = threading.Event()
        self._idle.set()
        self._server = ActionServer(
            node,
            work.kind,
            work.name,
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
            goal_service_qos_profile=SERVICE_QOS,
            result_service_qos_profile=SERVICE_QOS,
            cancel_service_qos_profile=SERVICE_QOS,
        )

    def stop(self, reason: str) -> None:
        """Cancel the goal that runs, and wait for its end."""
        with self._lock:
            running = self._running
        if running is not None:
            running.request(reason)
            self._idle.wait(END_TIMEOUT_S)

    def _on_accepted(self, goal: ServerGoalHandle) -> None:
        self._accepted[bytes(goal.goal_id.uuid)] = Cancellation()
        goal.execute()

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        cancellation = self._accepted.get(bytes(goal.goal_id.uuid))
        if cancellation is not None:
            cancellation.request(CANCELLED)
        return CancelResponse.ACCEPT

    def _execute(self, goal: ServerGoalHandle) -> Any:
        key = bytes(goal.goal_id.uuid)
        cancellation = self._accepted[key]
        result = self._work.kind.Result()
        try:
            self._run(goal, cancellation, result)
        finally:
            del self._accepted[key]
            self._forget(goal)
        return result

    def _forget(self, goal: ServerGoalHandle) -> None:
        """Free what the goal asked for: rclpy keeps goals for the 15 minutes that results live."""
        empty = self._work.kind.Goal()
        for field in empty.get_fields_and_field_types():
            setattr(goal.request, field, getattr(empty, field))

    def _run(self, goal: ServerGoalHandle, cancellation: Cancellation, result: Any) -> None:
        if not self._begin(cancellation):
            reason = f"another goal of {self._work.name} runs: cancel that one or wait for it"
            self._work.explain(goal, result, reason)
            goal.abort()
            return
        try:
            self._work.run(goal, cancellation, result)
            goal.succeed()
        except CancelledError as error:
            self._work.explain(goal, result, cancellation.reason or str(error))
            self._end_cancelled(goal, cancellation)
        except OaisysError as error:
            self._node.get_logger().warning(f"{self._work.name} failed: {error}")
            self._work.explain(goal, result, str(error))
            goal.abort()
        finally:
            self._end()

    def _end_cancelled(self, goal: ServerGoalHandle, cancellation: Cancellation) -> None:
        """End as cancelled if a client has asked for that, and as aborted otherwise."""
        end_s = time.monotonic() + CANCELLING_TIMEOUT_S
        asked = cancellation.reason == CANCELLED
        # rclpy calls _on_cancel before it changes the goal's state.
        while asked and not goal.is_cancel_requested and time.monotonic() < end_s:
            time.sleep(0.005)
        if goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()

    def _begin(self, cancellation: Cancellation) -> bool:
        with self._lock:
            if self._running is not None:
                return False
            self._running = cancellation
            self._idle.clear()
            return True

    def _end(self) -> None:
        with self._lock:
            self._running = None
            self._idle.set()
