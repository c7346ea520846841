"""Guards every call of the port, gRPC's own services included, against bad requests and clients.

Bytes that are no valid request end with INVALID_ARGUMENT and leave no traceback in the log. A call
whose request does not arrive is ended, and each method may have a limited number of streams.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from oaisys_core.errors import InvalidInputError, OaisysError, QueueFullError
from oaisys_grpc.contract.errors import abort
from oaisys_grpc.server.jobs.queue import QUEUE_LIMIT_OF_NEWCOMERS
from oaisys_grpc.server.limits.open_calls import (
    CROWDED_REQUESTS,
    MOST_WAITING,
    OpenCall,
    OpenCalls,
    Phase,
    Slots,
    counted,
    when_over,
)
from oaisys_grpc.server.limits.request_bounds import check_bounds, malformed

LIMITS = {
    "WatchOperation": 64,
    "RenderSample": 48,
    "GetSample": 16,
    "GetGroundTruthMesh": 8,
    "GetHeightField": 8,
    "Watch": 32,
    "GetFrame": 32,
}
"""Calls at a time, by method; all stream but GetFrame, whose answer may be as large."""

LIMIT_OF_OTHERS = 8
"""Other streams at a time, such as those of reflection."""

SHARE_OF_CONNECTION = 0.75
"""Share of each limit that one connection may have."""

_RESERVE = 24
"""Threads for calls that answer at once: health, cancellation, status."""

THREADS = (
    sum(LIMITS.values())
    + LIMIT_OF_OTHERS
    + MOST_WAITING * (len(LIMITS) + 1)
    + QUEUE_LIMIT_OF_NEWCOMERS
    + 2 * CROWDED_REQUESTS
    + _RESERVE
)
"""One for each stream, each unary call that waits for the worker, and each call whose request is
still to come."""


class StreamLimits:
    """Refuses calls beyond the limits, so that threads stay free for others."""

    def __init__(self) -> None:
        self._slots = {name: _slots(limit) for name, limit in LIMITS.items()}
        self._others = _slots(LIMIT_OF_OTHERS)

    @contextlib.contextmanager
    def slot(self, call: OpenCall) -> Iterator[None]:
        """Hold a slot for a call.

        Raises:
            QueueFullError: There is none.
        """
        slots = self._slots.get(call.name, self._others)
        _take(slots, call)
        try:
            yield
        finally:
            slots.release(call)

    def take(self, call: OpenCall, context: Any) -> None:
        """Take a slot for a unary call, if its method is limited, until its end.

        Raises:
            QueueFullError: There is none.
        """
        slots = self._slots.get(call.name)
        if slots is not None:
            _take(slots, call)
            when_over(context, lambda: slots.release(call))


def _take(slots: Slots, call: OpenCall) -> None:
    if not slots.take(call):
        raise QueueFullError(f"too many calls of {call.name} at a time; try again later")


def _slots(limit: int) -> Slots:
    return Slots(limit, int(SHARE_OF_CONNECTION * limit))


Handler = Any
"""A ``grpc.RpcMethodHandler``, or None for a call that nobody serves."""

Context = grpc.ServicerContext


class GuardedCalls(grpc.ServerInterceptor):
    """Reads requests instead of gRPC, which reports bad ones as internal errors of the server.

    All handlers become handlers of streams of bytes. On the wire this is the same, but it is known
    which threads wait for a request.
    """

    def __init__(self, calls: OpenCalls) -> None:
        self._calls = calls
        self._limits = StreamLimits()

    def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Handler],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler:
        """Return the call's handler, which checks its requests."""
        handler = continuation(handler_call_details)
        if handler is None:
            return handler
        self._calls.make_room()
        name = handler_call_details.method.rpartition("/")[2]
        behavior = handler.unary_unary or handler.unary_stream
        behavior = behavior or handler.stream_unary or handler.stream_stream
        read = handler.request_deserializer
        make_argument = _each if handler.request_streaming else _only

        def streamed(requests: Iterator[bytes], context: Context) -> Iterator[Any]:
            call = self._calls.add(context, name)
            try:
                argument = make_argument(requests, read, call)
                with self._limits.slot(call):
                    yield from counted(behavior(argument, context), call)
            except OaisysError as error:
                abort(context, error)

        def answered(requests: Iterator[bytes], context: Context) -> Any:
            call = self._calls.add(context, name)
            try:
                argument = make_argument(requests, read, call)
                self._limits.take(call, context)
                answer = behavior(argument, context)
            except OaisysError as error:
                abort(context, error)
            call.enter(Phase.READER)
            return answer

        if handler.response_streaming:
            return grpc.stream_stream_rpc_method_handler(
                streamed, response_serializer=handler.response_serializer
            )
        return grpc.stream_unary_rpc_method_handler(
            answered, response_serializer=handler.response_serializer
        )


def _only(requests: Iterator[bytes], read: Callable[[bytes], Any], call: OpenCall) -> Any:
    """Wait for the only request of a call and return it."""
    for request in _each(requests, read, call):
        return request
    raise InvalidInputError("request", "none", "one message")


def _each(requests: Iterator[bytes], read: Callable[[bytes], Any], call: OpenCall) -> Iterator[Any]:
    """Yield the requests of a call as they come."""
    call.enter(Phase.REQUEST)
    for data in requests:
        call.enter(Phase.WORK)
        yield _message(data, read)
        call.enter(Phase.REQUEST)
    call.enter(Phase.WORK)


def _message(data: bytes, read: Callable[[bytes], Any]) -> Any:
    """Return the message that some bytes are.

    Raises:
        InvalidInputError: They are none, or one with too much in it.
    """
    check_bounds(data, getattr(read, "__self__").DESCRIPTOR)  # noqa: B009 - a message's FromString
    try:
        return read(data)
    except DecodeError:
        raise malformed(data) from None
