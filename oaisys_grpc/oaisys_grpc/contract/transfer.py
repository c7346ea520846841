"""How a client wants its frames, and what a server grants of it."""

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
"""Smaller ones are refused: an image would be millions of messages."""

MAX_MESSAGE_BYTES = 3 << 20
"""Of array data in one message, whatever a client asks for: gRPC's default limit is 4 MiB."""

MAX_GROUP_BYTES = 2 << 20
"""Of array data in chunks that come in one message: larger ones are slower, as nobody reads the
beginning while the rest is being sent."""

MAX_FRAME_BYTES = 12 * MAX_IMAGE_PX
"""The largest image with three floats a pixel."""


@dataclass(frozen=True)
class Transfer:
    """How frames travel; the bits that arrive are the same either way.

    Attributes:
        encodings: The contract's `Encoding` values, the dearest first; raw is always understood.
        inline_bytes: Frames up to this size come whole, without chunks.
        chunk_bytes: Size of a chunk.
        frame_bytes: Decoded size of the largest frame that is taken.
        grouped: Whether parts may come together in one message.
        group_bytes: Of chunks in such a message; 0: they come one by one.
        token: Proves that the client reads the server's memory; frames then stay there.
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
    """Return the message of a client's wishes; inverse: `transfer_from_proto`."""
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
    """Return a client's wishes; 0 stands for what it does not mind."""
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
    """Return what of a client's wishes a server fulfils; ``probe`` is None without sharing.

    Raises:
        InvalidInputError: It wants chunks so small that sending them would keep the server busy.
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
    """Return what a server tells of its own limits."""
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
