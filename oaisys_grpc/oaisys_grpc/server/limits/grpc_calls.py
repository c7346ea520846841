"""What gRPC's Python server knows of a call but does not offer to applications.

Where a version of gRPC has it elsewhere, the public way is taken, which can do less.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import grpc


def event_of(arguments: Sequence[Any]) -> Any:
    """Return what a call is to gRPC, from what its server hands to its threads; None: unknown."""
    return next((each for each in arguments if hasattr(each, "call_details")), None)


def peer_of(event: Any) -> str:
    """Return the name of a call's connection; "" if it is unknown: all calls are one's then."""
    if event is None:
        return ""
    name = event.call.peer()
    return name.decode(errors="replace") if isinstance(name, bytes) else str(name)


def event_of_context(context: Any) -> Any:
    """Return what a call is to gRPC; None: unknown."""
    return getattr(context, "_rpc_event", None)


def cancel(event: Any, details: str) -> bool:
    """End a call with RESOURCE_EXHAUSTED, even within a message; return whether that was possible.

    No status can follow a message that is stuck, so the call is cancelled in gRPC's core.
    """
    if event is None:
        return False
    code, _ = grpc.StatusCode.RESOURCE_EXHAUSTED.value
    event.call.cancel(code, details.encode())
    return True
