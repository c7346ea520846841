"""The state machine of a lifecycle node, and its service that changes the state.

Private part: ``_state_machine.current_state`` and ``_service_change_state.callback`` of rclpy's
    ``LifecycleNodeMixin``.
Tried with: rclpy 7.1.6.
Public way without it: the state that the node's own transitions have led to.
Lost without it: the names of transition states (``activating``) in diagnostics; and a transition
    that the state does not have ends the node, as rclpy 7.1 raises there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

MACHINE, CHANGE_STATE = "_state_machine", "_service_change_state"
"""Attributes of a node."""


def current_state(node: Any, known: tuple[int, str]) -> tuple[int, str]:
    """Return the id and the name of a node's state; ``known`` where rclpy does not tell."""
    state = getattr(getattr(node, MACHINE, None), "current_state", None)
    if state is None:
        instead = "the names of transition states are not told"
        report_fallback("rclpy's state machine", f"a node has no {MACHINE}", instead)
        return known
    return int(state[0]), str(state[1])


def refuse_wrong_transitions(
    node: Any, on_wrong: Callable[[str], None], on_change: Callable[[], None]
) -> None:
    """Have the service refuse a transition that the state does not have, where rclpy raises.

    Args:
        node: The lifecycle node.
        on_wrong: Called with rclpy's error.
        on_change: Called after each request.
    """
    service = getattr(node, CHANGE_STATE, None)
    inner = getattr(service, "callback", None)
    if service is None or inner is None:
        instead = "a request for a transition that the state does not have ends the node"
        report_fallback("rclpy's service change_state", f"a node has no {CHANGE_STATE}", instead)
        return

    def on_change_state(request: Any, response: Any) -> Any:
        try:
            response = inner(request, response)
        except RuntimeError as error:
            on_wrong(str(error))
            response.success = False
        on_change()
        return response

    service.callback = on_change_state
