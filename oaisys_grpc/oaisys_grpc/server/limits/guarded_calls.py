"""Guards every call of the port, gRPC's own services included, against bad requests and clients.

Bytes that are no valid request end with INVALID_ARGUMENT and leave no traceback in the log. A call
whose request does not arrive is ended, and each method may have a limited number of streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_grpc.contract.errors import abort
from oaisys_grpc.contract.request_bounds import check_bounds, decoding_error
from oaisys_grpc.server.limits.open_calls import OpenCall, OpenCalls, Phase, count_answers
from oaisys_grpc.server.limits.slots import ANSWERED_AT_LENGTH, StreamLimits

Handler = Any
"""A ``grpc.RpcMethodHandler``, or None for a call that nobody serves."""

Context = grpc.ServicerContext


class GuardedCalls(grpc.ServerInterceptor):
    """Reads requests instead of gRPC, which reports bad ones as internal errors of the server.

    All handlers become handlers of streams of bytes. On the wire this is the same, but it is known
    which threads wait for a request.
    """

    def __init__(self, calls: OpenCalls, on_read: Callable[[str], None] = lambda _: None) -> None:
        """Guard calls.

        Args:
            calls: Those that are open.
            on_read: Called with the connection that has read an answer of the worker to its end.
        """
        self._calls, self._on_read = calls, on_read
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
        name = handler_call_details.method.rpartition("/")[2]
        behavior = handler.unary_unary or handler.unary_stream
        behavior = behavior or handler.stream_unary or handler.stream_stream
        read = handler.request_deserializer
        make_argument = _each if handler.request_streaming else _only

        def stream_call(requests: Iterator[bytes], context: Context) -> Iterator[Any]:
            call = self._calls.add(context, name)
            try:
                argument = make_argument(requests, read, call)
                with self._limits.slot(call):
                    answers = behavior(argument, context)
                    yield from count_answers(answers, call, lambda: self._limits.unread_slot(call))
                if name in ANSWERED_AT_LENGTH:
                    self._on_read(call.peer)
            except OaisysError as error:
                abort(context, error)

        def answer_call(requests: Iterator[bytes], context: Context) -> Any:
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
                stream_call, response_serializer=handler.response_serializer
            )
        return grpc.stream_unary_rpc_method_handler(
            answer_call, response_serializer=handler.response_serializer
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
    """Return the message that is encoded in some bytes.

    Raises:
        InvalidInputError: They are not a message of this type, or one that is too large.
    """
    check_bounds(data, getattr(read, "__self__").DESCRIPTOR)  # noqa: B009 - a message's FromString
    try:
        return read(data)
    except DecodeError:
        raise decoding_error(data) from None
