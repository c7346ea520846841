"""What a client that means no good sends: bytes as protobuf has them, and calls left half done."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import grpc

from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

OURS = "/oaisys.v1.SimulatorService/"

STRUCT, FIELDS, KEY, VALUE, LIST_VALUE, STRUCT_VALUE = 1, 1, 1, 2, 6, 5
"""Field numbers of google.protobuf.Struct and Value."""


def own_channel(address: str, *options: tuple[str, int]) -> Any:
    """A connection of its own; channels of one process share one otherwise."""
    return grpc.insecure_channel(address, options=[("grpc.use_local_subchannel_pool", 1), *options])


def nested(number: int, content: bytes) -> bytes:
    """A field that holds a message or a text."""
    size, length = len(content), bytearray()
    while size > 0x7F:
        length.append(size & 0x7F | 0x80)
        size >>= 7
    length.append(size)
    return bytes([number << 3 | 2]) + bytes(length) + content


def entry(key: bytes, value: bytes) -> bytes:
    """A member of a Struct."""
    return nested(FIELDS, nested(KEY, key) + nested(VALUE, value))


def in_metadata(part: str, struct: bytes) -> bytes:
    """A StepBatchRequest whose metadata hold a Struct."""
    number = pb.ModuleMetadata.DESCRIPTOR.fields_by_name[part].number
    metadata = pb.StepBatchRequest.DESCRIPTOR.fields_by_name["metadata"].number
    return nested(metadata, nested(number, struct))


def list_of_structs(size: int) -> bytes:
    """A Struct of about so many bytes: a list of empty ones."""
    member = nested(1, nested(STRUCT_VALUE, b""))
    return entry(b"x", nested(LIST_VALUE, member * (size // len(member))))


def mapping_of_structs(size: int) -> bytes:
    """A Struct of about so many bytes: a mapping of empty ones."""
    members = (entry(b"%05x" % i, nested(STRUCT_VALUE, b"")) for i in range(size // 13))
    return entry(b"x", nested(STRUCT_VALUE, b"".join(members)))


def deep_structs(size: int, depth: int = 25) -> bytes:
    """A Struct of about so many bytes: a list of deep ones."""
    inner = b""
    for _ in range(depth):
        inner = entry(b"a", nested(STRUCT_VALUE, inner))
    member = nested(1, nested(STRUCT_VALUE, inner))
    return entry(b"x", nested(LIST_VALUE, member * (size // len(member))))


def never(ended: threading.Event) -> Iterator[bytes]:
    """A request that does not come before the test has ended."""
    ended.wait()
    yield from ()


def code_and_details(call: Any) -> tuple[grpc.StatusCode, str]:
    """How a call ended that raises when it is read."""
    try:
        for _ in call:
            pass
    except grpc.RpcError as error:
        told: Any = error
        return told.code(), told.details()
    return grpc.StatusCode.OK, ""
