"""Guards every call of the port, gRPC's own services included, against bad requests and clients.

Bytes that are no valid request end with INVALID_ARGUMENT and leave no traceback in the log. A call
whose request does not arrive is ended, and each method may have a limited number of streams. The
content of a request is bounded before protobuf parses it: four megabytes of empty structs would
become a million objects.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_grpc.contract.errors import abort
from oaisys_grpc.server.limits.open_calls import OpenCall, OpenCalls, Phase, count_answers
from oaisys_grpc.server.limits.slots import ANSWERED_AT_LENGTH, StreamLimits

MAX_FIELDS = 2**17
"""Fields of all messages in a request: 2,000 objects with pose, size and label."""

MAX_DEPTH = 64
"""Nested messages; a Struct in a Struct counts three."""

_VARINT, _FIXED64, _LENGTH_DELIMITED, _FIXED32 = 0, 1, 2, 5
_SKIPPED_BYTES = {_FIXED64: 8, _FIXED32: 4}
_LONGEST_KEY = 2**32
_LONGEST_VARINT = 10

Fields = dict[int, Any]
"""Descriptors of the messages that a message's fields hold, by the field's number."""

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


def check_bounds(data: bytes, descriptor: Any) -> None:
    """Refuse a request with too many fields, with too deep ones, or that is no message.

    It stops at the first field too many, so that a refusal takes a fraction of a second.

    Args:
        data: The request's bytes.
        descriptor: Of the message that they should be.

    Raises:
        InvalidInputError: The request is out of bounds.
    """
    if _is_flat(descriptor):
        return  # a list of numbers takes no more memory than its bytes
    try:
        _walk(data, descriptor)
    except IndexError:
        raise decoding_error(data) from None


def decoding_error(data: bytes) -> InvalidInputError:
    """Return the error of bytes that are no message."""
    return InvalidInputError("request", f"{len(data)} bytes", "a message of this call")


def _walk(data: bytes, descriptor: Any) -> None:
    at, count = 0, 0
    open_messages = [(len(data), _messages_in(descriptor))]
    while open_messages:
        end, messages = open_messages[-1]
        if at >= end:
            if at > end:
                raise decoding_error(data)
            open_messages.pop()
            continue
        count += 1
        if count > MAX_FIELDS:
            raise _refusal(f"more than {MAX_FIELDS} fields", f"at most {MAX_FIELDS}")
        key, at = _varint(data, at)
        inner = messages.get(key >> 3) if key & 7 == _LENGTH_DELIMITED else None
        if inner is None:
            at = _behind(data, at, key)
            continue
        length, at = _varint(data, at)
        if at + length > end:
            raise decoding_error(data)
        if len(open_messages) == MAX_DEPTH:
            raise _refusal(f"messages more than {MAX_DEPTH} deep", f"at most {MAX_DEPTH}")
        open_messages.append((at + length, _messages_in(inner)))


def _behind(data: bytes, at: int, key: int) -> int:
    """Return the end of a field that is no message; its value begins at ``at``."""
    kind = key & 7
    if not 8 <= key < _LONGEST_KEY:  # no field at all
        raise decoding_error(data)
    if kind == _LENGTH_DELIMITED:
        length, at = _varint(data, at)
        return at + length
    if kind == _VARINT:
        return _varint(data, at)[1]
    if kind not in _SKIPPED_BYTES:  # a group, which no call of ours has
        raise decoding_error(data)
    return at + _SKIPPED_BYTES[kind]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the number that begins there, and where it ends."""
    byte = data[at]
    if byte < 0x80:
        return byte, at + 1
    number = byte & 0x7F
    for index in range(1, _LONGEST_VARINT):
        byte = data[at + index]
        number |= (byte & 0x7F) << 7 * index
        if byte < 0x80:
            return number, at + index + 1
    raise decoding_error(data)


@functools.cache
def _messages_in(descriptor: Any) -> Fields:
    return {
        field.number: field.message_type
        for field in descriptor.fields
        if field.message_type is not None
    }


@functools.cache
def _is_flat(descriptor: Any) -> bool:
    """Return whether a message holds fields, but neither messages nor lists of texts."""
    # Parsing a message without fields lets some bytes pass that are none.
    return bool(descriptor.fields) and not any(
        field.message_type is not None
        or (field.is_repeated and field.cpp_type == field.CPPTYPE_STRING)
        for field in descriptor.fields
    )


def _refusal(received: str, expected: str) -> InvalidInputError:
    return InvalidInputError("request", received, expected)
