"""How a client wants its frames sent, and what a server grants."""

from __future__ import annotations

from dataclasses import dataclass, replace

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import MAX_IMAGE_PX
from oaisys_grpc.contract.encodings import CODECS
from oaisys_grpc.contract.limits import MAX_REQUEST_BYTES
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.worker.shared_memory import Place, Probe

CHUNK_BYTES = 1 << 20
"""For a client that says nothing."""

MIN_CHUNK_BYTES = 1000
"""Smaller chunks are refused, because an image would take millions of messages."""

MAX_MESSAGE_BYTES = 3 << 20
"""Array data of one message at most; gRPC's default limit for messages is 4 MiB."""

MAX_GROUP_BYTES = 2 << 20
"""Array data of one message's chunks at most; larger messages are slower."""

MAX_FRAME_BYTES = 12 * MAX_IMAGE_PX
"""The largest image with three floats a pixel."""


@dataclass(frozen=True)
class Transfer:
    """How frames are sent; all ways are lossless.

    Attributes:
        encodings: The contract's `Encoding` values, the preferred ones first; raw is always
            accepted.
        inline_bytes: Frames up to this size are sent whole, without chunks.
        chunk_bytes: Size of a chunk.
        frame_bytes: Decoded size of the largest frame that the client accepts.
        grouped: Whether several parts may be sent in one message.
        group_bytes: Array data of the chunks in such a message; 0: chunks are sent one by one.
        token: Proves that the client can read the server's memory; frames then stay there.
    """

    encodings: tuple[int, ...] = ()
    inline_bytes: int = 0
    chunk_bytes: int = CHUNK_BYTES
    frame_bytes: int = MAX_FRAME_BYTES
    grouped: bool = False
    group_bytes: int = 0
    token: bytes = b""


DEFAULT_TRANSFER = Transfer()
"""For a client that says nothing."""


def transfer_to_proto(transfer: Transfer) -> pb.TransferOptions:
    """Return the message of a client's options; inverse: `transfer_from_proto`."""
    return pb.TransferOptions(
        accepted_encodings=[pb.Encoding.ValueType(value) for value in transfer.encodings],
        max_inline_bytes=transfer.inline_bytes,
        max_chunk_bytes=transfer.chunk_bytes,
        max_frame_bytes=transfer.frame_bytes,
        shared_memory_token=transfer.token,
        group_parts=transfer.grouped,
        max_group_bytes=transfer.group_bytes,
    )


def transfer_from_proto(message: pb.TransferOptions) -> Transfer:
    """Return a client's options; 0 stands for the default."""
    return Transfer(
        encodings=tuple(message.accepted_encodings),
        inline_bytes=message.max_inline_bytes,
        chunk_bytes=message.max_chunk_bytes or CHUNK_BYTES,
        frame_bytes=message.max_frame_bytes or MAX_FRAME_BYTES,
        grouped=message.group_parts,
        group_bytes=message.max_group_bytes,
        token=message.shared_memory_token,
    )


def granted(transfer: Transfer, probe: Probe | None) -> Transfer:
    """Return what a server grants of a client's options; ``probe`` is None without sharing.

    Raises:
        InvalidInputError: The chunks are too small.
    """
    if transfer.chunk_bytes < MIN_CHUNK_BYTES:
        expected = f"0, or at least {MIN_CHUNK_BYTES}"
        raise InvalidInputError("transfer.max_chunk_bytes", transfer.chunk_bytes, expected)
    proved = probe is not None and probe.proves(transfer.token)
    return replace(
        transfer,
        inline_bytes=min(transfer.inline_bytes, MAX_MESSAGE_BYTES),
        chunk_bytes=min(transfer.chunk_bytes, MAX_MESSAGE_BYTES),
        group_bytes=min(transfer.group_bytes, MAX_GROUP_BYTES),
        token=transfer.token if proved else b"",
    )


def limits_message() -> pb.TransferLimits:
    """Return the message of a server's limits."""
    return pb.TransferLimits(
        max_frame_bytes=MAX_FRAME_BYTES,
        max_chunk_bytes=MAX_MESSAGE_BYTES,
        max_inline_bytes=MAX_MESSAGE_BYTES,
        max_request_bytes=MAX_REQUEST_BYTES,
        encodings=[pb.ENCODING_RAW, *(pb.Encoding.ValueType(value) for value in CODECS)],
        max_group_bytes=MAX_GROUP_BYTES,
    )


def place_to_proto(place: Place) -> pb.SharedMemory:
    """Return the message of a place in shared memory; inverse: `place_from_proto`."""
    return pb.SharedMemory(**place._asdict())


def place_from_proto(message: pb.SharedMemory) -> Place:
    """Return a place in shared memory."""
    return Place(*(getattr(message, name) for name in Place._fields))
