"""How frames are sent: what a client asks for, what a server grants, and a sample's messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.types import POINTS, FrameName
from oaisys_grpc.contract import arrays
from oaisys_grpc.contract.arrays import CHUNK_BYTES, CODECS, MAX_FRAME_BYTES
from oaisys_grpc.contract.conversion import Conversion, RecordConversion
from oaisys_grpc.contract.request_bounds import MAX_REQUEST_BYTES
from oaisys_grpc.contract.sample_messages import FrameMessage, SampleMessages
from oaisys_grpc.contract.shared_memory import MemoryLocation, Probe, location_of
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

MIN_CHUNK_BYTES = 1000
"""Smaller chunks are refused, because an image would take millions of messages."""

MAX_MESSAGE_BYTES = 3 << 20
"""Array data of one message at most; gRPC's default limit for messages is 4 MiB."""

MAX_GROUP_BYTES = 2 << 20
"""Array data of one message's chunks at most; larger messages are slower."""


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


_TRANSFER = RecordConversion(
    Transfer,
    pb.TransferOptions,
    renamed={
        "encodings": "accepted_encodings",
        "inline_bytes": "max_inline_bytes",
        "chunk_bytes": "max_chunk_bytes",
        "frame_bytes": "max_frame_bytes",
        "grouped": "group_parts",
        "group_bytes": "max_group_bytes",
        "token": "shared_memory_token",
    },
    # 0 stands for the default.
    chunk_bytes=Conversion(int, lambda size: size or CHUNK_BYTES),
    frame_bytes=Conversion(int, lambda size: size or MAX_FRAME_BYTES),
)
transfer_to_proto, transfer_from_proto = _TRANSFER.to_proto, _TRANSFER.from_proto


def grant(transfer: Transfer, probe: Probe | None) -> Transfer:
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


def location_to_proto(location: MemoryLocation) -> pb.SharedMemory:
    """Return the message of a location in shared memory; inverse: `location_from_proto`."""
    return pb.SharedMemory(**location._asdict())


def location_from_proto(message: pb.SharedMemory) -> MemoryLocation:
    """Return a location in shared memory."""
    return MemoryLocation(*(getattr(message, name) for name in MemoryLocation._fields))


def sample_to_parts(
    sample: SampleMessages, transfer: Transfer = DEFAULT_TRANSFER
) -> Iterator[pb.SamplePart]:
    """Yield a sample, or pieces of it, as a client wants them; inverse: its `SampleStream`."""

    def parts() -> Iterator[pb.SamplePart]:
        if sample.header is not None:
            yield pb.SamplePart(sample=sample.header)
        for frame in sample.frames:
            yield from _frame_parts(frame, transfer)
        if sample.end is not None:
            yield pb.SamplePart(end=sample.end)

    yield from _group_parts(parts(), transfer)


def _frame_parts(frame: FrameMessage, transfer: Transfer) -> Iterator[pb.SamplePart]:
    """Yield a frame's header and chunks.

    Raises:
        InvalidInputError: The client does not take frames as large as this one.
    """
    header, image = frame
    if image.nbytes > transfer.frame_bytes:
        expected = f"at least {image.nbytes}, which {header.sensor}/{header.modality} has"
        raise InvalidInputError("transfer.max_frame_bytes", transfer.frame_bytes, expected)
    location = location_of(image) if transfer.token else None
    if location is not None:
        part = pb.SamplePart(frame=header)  # which copies the header
        part.frame.shared_memory.CopyFrom(location_to_proto(location))
        yield part
        return
    part, data = _encode_part(frame, transfer.encodings)
    if data.size <= transfer.inline_bytes:
        part.frame.data = data.tobytes()
        yield part
        return
    yield part
    for chunk in arrays.array_chunks(data, header.index, transfer.chunk_bytes):
        yield pb.SamplePart(chunk=chunk)


def _encode_part(
    frame: FrameMessage, accepted: Iterable[int]
) -> tuple[pb.SamplePart, NDArray[np.uint8]]:
    """Return a copy of a frame's header for its encoded image, and the image's bytes."""
    part = pb.SamplePart(frame=frame.header)
    if frame.header.modality == POINTS:
        # Points are no image, and may have more rows than a PNG file.
        accepted = [encoding for encoding in accepted if encoding != pb.ENCODING_PNG]
    array, data = arrays.encode(frame.image, accepted)
    part.frame.array.CopyFrom(array)
    return part, data


def frame_response(
    sample: SampleMessages, name: FrameName, accepted: Iterable[int]
) -> pb.GetFrameResponse:
    """Return one frame of a sample in one message.

    Raises:
        NotFoundError: The sample has no such frame.
        InvalidInputError: It is too large for one message.
    """
    found = [f for f in sample.frames if FrameName(f.header.sensor, f.header.modality) == name]
    if not found:
        raise NotFoundError(f"the sample has no frame {name.sensor}/{name.modality}")
    part, data = _encode_part(found[0], accepted)
    if data.size > MAX_MESSAGE_BYTES:
        expected = f"a frame of at most {MAX_MESSAGE_BYTES} bytes: GetSample sends larger ones"
        raise InvalidInputError("modality", f"{name.modality} of {data.size} bytes", expected)
    part.frame.data = data.tobytes()
    return pb.GetFrameResponse(sample=sample.header, frame=part.frame)


def _group_parts(parts: Iterable[pb.SamplePart], transfer: Transfer) -> Iterator[pb.SamplePart]:
    """Yield parts with neighbours put together, for a client that takes them so."""
    group: list[pb.SamplePart] = []
    inline_bytes = chunk_bytes = 0
    for part in parts:
        in_chunk, inline = len(part.chunk.data), len(part.frame.data)
        inline_bytes, chunk_bytes = inline_bytes + inline, chunk_bytes + in_chunk
        if inline_bytes > transfer.inline_bytes or chunk_bytes > transfer.group_bytes:
            yield from _group(group)
            group, inline_bytes, chunk_bytes = [], inline, in_chunk
        group.append(part)
        if not transfer.grouped or in_chunk > transfer.group_bytes:
            yield from _group(group)
            group, inline_bytes, chunk_bytes = [], 0, 0
    yield from _group(group)


def _group(parts: list[pb.SamplePart]) -> Iterator[pb.SamplePart]:
    if len(parts) < 2:
        yield from parts
    else:
        yield pb.SamplePart(group=pb.SamplePartGroup(parts=parts))
