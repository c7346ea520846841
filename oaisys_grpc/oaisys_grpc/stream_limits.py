"""How many streaming calls there may be at a time: each holds a thread as long as it lasts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import grpc

from oaisys_core.errors import QueueFullError
from oaisys_grpc.errors import abort
from oaisys_grpc.operations import QUEUE_LIMIT

LIMITS = {
    "WatchOperation": 64,
    "RenderSample": 48,
    "GetSample": 16,
    "GetGroundTruthMesh": 8,
    "GetHeightField": 8,
}
"""By the call's name."""

LIMIT_OF_OTHERS = 8
"""Of all other streams together, such as those of reflection."""

_RESERVE = 24
"""Threads for calls that answer at once: health, cancelling, asking how things stand."""

THREADS = sum(LIMITS.values()) + LIMIT_OF_OTHERS + QUEUE_LIMIT + _RESERVE
"""Of a server: one for each stream, and for each unary call that waits for the worker."""

Handler = Any
"""A ``grpc.RpcMethodHandler``, or None for a call that nobody serves."""


class StreamLimits(grpc.ServerInterceptor):
    """Ends streaming calls that are too many with RESOURCE_EXHAUSTED, and the threads stay free."""

    def __init__(self) -> None:
        self._slots = {name: threading.Semaphore(limit) for name, limit in LIMITS.items()}
        self._others = threading.Semaphore(LIMIT_OF_OTHERS)

    def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Handler],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler:
        """Return the call's handler, which takes a slot first if it streams."""
        handler = continuation(handler_call_details)
        if handler is None or not handler.response_streaming:
            return handler
        behavior: Any = handler.stream_stream or handler.unary_stream
        if getattr(behavior, "experimental_non_blocking", False):
            return handler  # health's: it holds no thread
        make: Any = grpc.unary_stream_rpc_method_handler
        if handler.request_streaming:
            make = grpc.stream_stream_rpc_method_handler
        name = handler_call_details.method.rpartition("/")[2]
        limited: Handler = make(
            _limited(behavior, self._slots.get(name, self._others), name),
            request_deserializer=handler.request_deserializer,
            response_serializer=handler.response_serializer,
        )
        return limited


def _limited(
    behavior: Callable[..., Iterator[Any]], slots: threading.Semaphore, name: str
) -> Callable[..., Iterator[Any]]:
    def stream(request: Any, context: grpc.ServicerContext) -> Iterator[Any]:
        if not slots.acquire(blocking=False):
            abort(context, QueueFullError(f"too many calls of {name} at a time; try again later"))
        try:
            yield from behavior(request, context)
        finally:
            slots.release()

    return stream
