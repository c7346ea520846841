"""What a call is to gRPC's Python server: its event, which can be ended even within a message.

Private part: ``_rpc_event`` of a ``grpc.ServicerContext``; the argument with ``call_details`` that
    the server hands to its threads; ``peer`` and ``cancel`` of an event's ``call``; its
    ``invocation_metadata``.
Tried with: grpcio 1.85.1.
Public way without it: ``ServicerContext.cancel`` ends a call once gRPC has begun to serve it.
Lost without it: the code RESOURCE_EXHAUSTED with its reason; the turns of connections, as all calls
    count as those of one; and the end of calls that wait for a thread.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import grpc

from oaisys_core.system.fallbacks import report_fallback
from oaisys_grpc.contract.connection_names import connection_name

OF_CONTEXT, IN_ARGUMENT, OF_METADATA = "_rpc_event", "call_details", "invocation_metadata"
"""Attribute of a context that is its event, one that events have, and that of their metadata."""

_INSTEAD = "clients are told less of why a call ended, and connections take no turns"


def event_of(arguments: Sequence[Any]) -> Any:
    """Return what a call is to gRPC, from what its server hands to its threads; None: unknown."""
    for each in arguments:
        if hasattr(each, IN_ARGUMENT):
            return each
    report_fallback("gRPC's event of a call", f"no argument has {IN_ARGUMENT}", _INSTEAD)
    return None


def peer_of(event: Any) -> str:
    """Return the name of a call's connection; "" if it is unknown: all calls are one's then."""
    if event is None:
        return ""
    peer = event.call.peer()
    name = peer.decode(errors="replace") if isinstance(peer, bytes) else str(peer)
    return connection_name(name, getattr(event, OF_METADATA, None))


def event_of_context(context: Any) -> Any:
    """Return what a call is to gRPC; None: unknown."""
    event = getattr(context, OF_CONTEXT, None)
    if event is None:
        report_fallback("gRPC's event of a call", f"a context has no {OF_CONTEXT}", _INSTEAD)
    return event


def cancel(event: Any, details: str) -> bool:
    """End a call with RESOURCE_EXHAUSTED, even within a message; return whether that was possible.

    No status can follow a message that is stuck, so the call is cancelled in gRPC's core.
    """
    if event is None:
        return False
    code, _ = grpc.StatusCode.RESOURCE_EXHAUSTED.value
    event.call.cancel(code, details.encode())
    return True
