"""Messages that carry a piece of an array, made and read without protobuf's copies of its bytes.

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

AnyMessage = TypeVar("AnyMessage", bound=Message)


@dataclass(frozen=True, slots=True)
class RawChunk:
    """The contract's `Chunk`, whose data are still where they were."""

    index: int
    offset: int
    data: memoryview


Part = pb.SamplePart | RawChunk
"""Of a sample."""


def response(kind: type[AnyMessage], part: Part) -> AnyMessage | bytes:
    """Return a part of a sample, or a chunk of a mesh, as a message or as its bytes."""
    if isinstance(part, RawChunk):
        return _packed(_path(kind.DESCRIPTOR), part)
    return kind(part=part)


def parser(kind: type[AnyMessage]) -> Callable[[bytes], AnyMessage | RawChunk]:
    """Return what reads messages of a kind, those with a chunk as that chunk."""
    path = _path(kind.DESCRIPTOR)

    def parsed(content: bytes) -> AnyMessage | RawChunk:
        chunk = _unpacked(path, content)
        return kind.FromString(content) if chunk is None else chunk

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


def _packed(path: tuple[int, ...], chunk: RawChunk) -> bytes:
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
    for tag in reversed(path):
        head = bytes([tag]) + _varint(len(head) + chunk.data.nbytes) + head
    return b"".join((head, chunk.data))


def _unpacked(path: tuple[int, ...], content: bytes) -> RawChunk | None:
    """Return the chunk that a message consists of; None where protobuf must read it."""
    try:
        at = 0
        for tag in path:
            length, begin = _number(content, at + 1)
            if content[at] != tag or begin + length != len(content):
                return None
            at = begin
        numbers = {_INDEX: 0, _OFFSET: 0}
        while content[at] in numbers:
            tag = content[at]
            numbers[tag], at = _number(content, at + 1)
        length, begin = _number(content, at + 1)
        if content[at] != _DATA or begin + length != len(content):
            return None
    except IndexError:
        return None
    return RawChunk(numbers[_INDEX], numbers[_OFFSET], memoryview(content)[begin:])


def _varint(number: int) -> bytes:
    """Return a number as protobuf has it: seven bits a byte, the lowest first."""
    content = bytearray()
    while number > 0x7F:
        content.append(number & 0x7F | 0x80)
        number >>= 7
    content.append(number)
    return bytes(content)


def _number(content: bytes, at: int) -> tuple[int, int]:
    """Return the varint that begins there, and where it ends."""
    number = shift = 0
    while content[at] & 0x80:
        number |= (content[at] & 0x7F) << shift
        shift += 7
        at += 1
    return number | content[at] << shift, at + 1
