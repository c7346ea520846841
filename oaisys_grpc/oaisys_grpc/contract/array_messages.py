"""Messages that carry pieces of arrays, made and read without protobuf's copies of its bytes.

On the wire they are the contract's messages. Protobuf would copy the bytes three more times on
either side, which took longer than all else that a frame goes through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import grpc
from google.protobuf.message import Message

from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

_LENGTH_DELIMITED = 2
_INDEX, _OFFSET, _DATA = (
    pb.Chunk.DESCRIPTOR.fields_by_name[name].number << 3 | wire_type
    for name, wire_type in (("index", 0), ("offset", 0), ("data", _LENGTH_DELIMITED))
)
"""What precedes the fields of a chunk."""

_CHUNK, _GROUP, _MEMBER = (
    message.DESCRIPTOR.fields_by_name[name].number << 3 | _LENGTH_DELIMITED
    for message, name in (
        (pb.SamplePart, "chunk"),
        (pb.SamplePart, "group"),
        (pb.SamplePartGroup, "parts"),
    )
)
"""What precedes a chunk in a part, a group in a part, and a part in a group."""

_RAW_FROM_BYTES = 64 << 10
"""A smaller group is protobuf's to read: its chunks, if any, are not worth more than that."""

AnyMessage = TypeVar("AnyMessage", bound=Message)


@dataclass(frozen=True, slots=True)
class RawChunk:
    """The contract's `Chunk`, whose data are still where they were."""

    index: int
    offset: int
    data: memoryview


SinglePart = pb.SamplePart | RawChunk


@dataclass(frozen=True, slots=True)
class RawGroup:
    """The contract's `SamplePartGroup`, the data of whose chunks are still where they were."""

    parts: tuple[SinglePart, ...]


RawPart = RawChunk | RawGroup
Part = pb.SamplePart | RawPart
"""Of a sample."""


def response(kind: type[AnyMessage], part: Part) -> AnyMessage | bytes:
    """Return a part of a sample, or a chunk of a mesh, as a message or as its bytes."""
    path = _path(kind.DESCRIPTOR)
    if isinstance(part, RawChunk):
        return b"".join(_packed(path, part))
    if isinstance(part, RawGroup):
        pieces = [piece for member in part.parts for piece in _packed_member(member)]
        return b"".join(_wrapped((*path[:-1], _GROUP), pieces))
    return kind(part=part)


def parser(kind: type[AnyMessage]) -> Callable[[bytes], AnyMessage | RawPart]:
    """Return what reads messages of a kind, those with chunks as these."""
    path = _path(kind.DESCRIPTOR)
    to_group = (*path[:-1], _GROUP) if len(path) > 1 else ()

    def parsed(content: bytes) -> AnyMessage | RawPart:
        part: RawPart | None = _unpacked(path, memoryview(content))
        if part is None and to_group and len(content) >= _RAW_FROM_BYTES:
            part = _unpacked_group(to_group, memoryview(content))
        return kind.FromString(content) if part is None else part

    return parsed


def add_servicer(servicer: object, server: grpc.Server) -> None:
    """Have a server answer the contract's calls; a response may be bytes already."""
    service = pb.DESCRIPTOR.services_by_name["SimulatorService"]
    handlers = {}
    for method in service.methods:
        request: type[Message] = getattr(pb, method.input_type.name)
        handler = (
            grpc.unary_stream_rpc_method_handler
            if method.server_streaming
            else grpc.unary_unary_rpc_method_handler
        )
        handlers[method.name] = handler(
            getattr(servicer, method.name),
            request_deserializer=request.FromString,
            response_serializer=_serialized,
        )
    generic = grpc.method_handlers_generic_handler(service.full_name, handlers)
    server.add_generic_rpc_handlers((generic,))


def _serialized(message: Any) -> bytes:
    content: bytes = message if isinstance(message, bytes) else message.SerializeToString()
    return content


def _path(message: Any) -> tuple[int, ...]:
    """Return the tags that lead from a message to its chunk."""
    path = []
    while message.full_name != pb.Chunk.DESCRIPTOR.full_name:
        names = message.fields_by_name
        field = names["chunk"] if "chunk" in names else names["part"]
        path.append(field.number << 3 | _LENGTH_DELIMITED)
        message = field.message_type
    return tuple(path)


def _packed_member(part: SinglePart) -> list[bytes | memoryview]:
    """Return the pieces of a part as a member of its group."""
    if isinstance(part, RawChunk):
        return _packed((_MEMBER, _CHUNK), part)
    return _wrapped((_MEMBER,), [part.SerializeToString()])


def _packed(path: tuple[int, ...], chunk: RawChunk) -> list[bytes | memoryview]:
    """Return the pieces of a message with a chunk."""
    head = b"".join(
        (
            bytes([_INDEX]),
            _varint(chunk.index),
            bytes([_OFFSET]),
            _varint(chunk.offset),
            bytes([_DATA]),
            _varint(chunk.data.nbytes),
        )
    )
    return _wrapped(path, [head, chunk.data])


def _wrapped(path: tuple[int, ...], pieces: list[bytes | memoryview]) -> list[bytes | memoryview]:
    """Return the pieces of a message with those of its content before them."""
    size = sum(len(piece) for piece in pieces)
    head = b""
    for tag in reversed(path):
        head = bytes([tag]) + _varint(size + len(head)) + head
    return [head, *pieces]


def _unpacked_group(path: tuple[int, ...], content: memoryview) -> RawGroup | None:
    """Return the group that a message consists of; None where protobuf must read it."""
    parts: list[SinglePart] = []
    try:
        at = _entered(path, content)
        while at is not None and at < len(content):
            length, begin = _number(content, at + 1)
            if content[at] != _MEMBER or begin + length > len(content):
                return None
            member = content[begin : begin + length]
            chunk = _unpacked((_CHUNK,), member)
            parts.append(pb.SamplePart.FromString(bytes(member)) if chunk is None else chunk)
            at = begin + length
    except IndexError:
        return None
    return None if at is None else RawGroup(tuple(parts))


def _unpacked(path: tuple[int, ...], content: memoryview) -> RawChunk | None:
    """Return the chunk that a message consists of; None where protobuf must read it."""
    try:
        at = _entered(path, content)
        if at is None:
            return None
        numbers = {_INDEX: 0, _OFFSET: 0}
        while content[at] in numbers:
            tag = content[at]
            numbers[tag], at = _number(content, at + 1)
        length, begin = _number(content, at + 1)
        if content[at] != _DATA or begin + length != len(content):
            return None
    except IndexError:
        return None
    return RawChunk(numbers[_INDEX], numbers[_OFFSET], content[begin:])


def _entered(path: tuple[int, ...], content: memoryview) -> int | None:
    """Return where the innermost field begins, if each is all that is in the one around it."""
    at = 0
    for tag in path:
        length, begin = _number(content, at + 1)
        if content[at] != tag or begin + length != len(content):
            return None
        at = begin
    return at


def _varint(number: int) -> bytes:
    """Return a number as protobuf has it: seven bits a byte, the lowest first."""
    content = bytearray()
    while number > 0x7F:
        content.append(number & 0x7F | 0x80)
        number >>= 7
    content.append(number)
    return bytes(content)


def _number(content: memoryview, at: int) -> tuple[int, int]:
    """Return the varint that begins there, and where it ends."""
    number = shift = 0
    while content[at] & 0x80:
        number |= (content[at] & 0x7F) << shift
        shift += 7
        at += 1
    return number | content[at] << shift, at + 1
