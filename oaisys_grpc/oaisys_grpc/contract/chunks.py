"""Samples, meshes and height grids as streams of small messages, and back; in pairs.

`oaisys_grpc.client.sample_stream` reads a sample's parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, NotFoundError, OaisysError
from oaisys_core.types import FrameName, HeightGrid, TriangleMesh
from oaisys_grpc.contract import encodings
from oaisys_grpc.contract.sample_messages import FrameMessage, SampleMessages
from oaisys_grpc.contract.transfer import (
    CHUNK_BYTES,
    DEFAULT_TRANSFER,
    MAX_FRAME_BYTES,
    MAX_MESSAGE_BYTES,
    Transfer,
    place_to_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.worker.shared_memory import place_of

AnyArray = NDArray[Any]


class ArrayAssembly:
    """Puts an array together from its header and its chunks, in one allocation."""

    def __init__(self, header: pb.ArrayHeader, limit: int = MAX_FRAME_BYTES) -> None:
        """Check the header and allocate.

        Args:
            limit: Most bytes that the array may have, decoded.

        Raises:
            OaisysError: The header contradicts itself, or says what this client cannot read.
        """
        encodings.checked_nbytes(header, limit)
        self._header = header
        self._bytes = np.empty(header.byte_size, dtype=np.uint8)
        self._received = 0

    def add(self, chunk: pb.Chunk) -> None:
        """Take the next piece.

        Raises:
            OaisysError: It does not follow the piece before, or runs over the end.
        """
        end = chunk.offset + len(chunk.data)
        if chunk.offset != self._received or end > self._bytes.size:
            raise OaisysError(f"a chunk is out of order: offset {chunk.offset}")
        self._bytes[chunk.offset : end] = np.frombuffer(chunk.data, dtype=np.uint8)
        self._received = end

    @property
    def is_complete(self) -> bool:
        """Whether all pieces have come."""
        return self._received == self._bytes.size

    def array(self) -> AnyArray:
        """Return the array.

        Raises:
            OaisysError: Pieces are missing, or cannot be decoded.
        """
        if not self.is_complete:
            raise OaisysError(f"{self._received} of {self._bytes.size} bytes came")
        return encodings.decoded(self._header, self._bytes)


def array_chunks(
    data: NDArray[np.uint8], index: int, size: int = CHUNK_BYTES
) -> Iterator[pb.Chunk]:
    """Yield an encoded array's bytes in pieces; inverse: `ArrayAssembly`."""
    for offset in range(0, data.size, size):
        yield pb.Chunk(index=index, offset=offset, data=data[offset : offset + size].tobytes())


def sample_to_parts(
    sample: SampleMessages, transfer: Transfer = DEFAULT_TRANSFER
) -> Iterator[pb.SamplePart]:
    """Yield a sample, or pieces of it, as a client wants them; inverse: `sample_from_parts`."""

    def parts() -> Iterator[pb.SamplePart]:
        if sample.header is not None:
            yield pb.SamplePart(sample=sample.header)
        for frame in sample.frames:
            yield from _frame_parts(frame, transfer)
        if sample.end is not None:
            yield pb.SamplePart(end=sample.end)

    yield from _grouped(parts(), transfer)


def _frame_parts(frame: FrameMessage, transfer: Transfer) -> Iterator[pb.SamplePart]:
    """Yield a frame's header and chunks.

    Raises:
        InvalidInputError: The client does not take frames as large as this one.
    """
    header, image = frame
    if image.nbytes > transfer.frame_bytes:
        expected = f"at least {image.nbytes}, which {header.sensor}/{header.modality} has"
        raise InvalidInputError("transfer.max_frame_bytes", transfer.frame_bytes, expected)
    place = place_of(image) if transfer.token else None
    if place is not None:
        part = pb.SamplePart(frame=header)  # which copies the header
        part.frame.shared_memory.CopyFrom(place_to_proto(place))
        yield part
        return
    part, data = _encoded_part(frame, transfer.encodings)
    if data.size <= transfer.inline_bytes:
        part.frame.data = data.tobytes()
        yield part
        return
    yield part
    for chunk in array_chunks(data, header.index, transfer.chunk_bytes):
        yield pb.SamplePart(chunk=chunk)


def _encoded_part(
    frame: FrameMessage, accepted: Iterable[int]
) -> tuple[pb.SamplePart, NDArray[np.uint8]]:
    """Return a copy of a frame's header for its encoded image, and the image's bytes."""
    part = pb.SamplePart(frame=frame.header)
    array, data = encodings.encoded(frame.image, accepted)
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
    part, data = _encoded_part(found[0], accepted)
    if data.size > MAX_MESSAGE_BYTES:
        expected = f"a frame of at most {MAX_MESSAGE_BYTES} bytes: GetSample sends larger ones"
        raise InvalidInputError("modality", f"{name.modality} of {data.size} bytes", expected)
    part.frame.data = data.tobytes()
    return pb.GetFrameResponse(sample=sample.header, frame=part.frame)


def _grouped(parts: Iterable[pb.SamplePart], transfer: Transfer) -> Iterator[pb.SamplePart]:
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


def mesh_to_message(
    mesh: TriangleMesh,
) -> tuple[pb.GetGroundTruthMeshResponse, list[NDArray[np.uint8]]]:
    """Return a mesh's header, and the bytes of its arrays in the order of their indices.

    Inverse, once the arrays are sent as `array_chunks`: `mesh_from_parts`.
    """
    given = {name: getattr(mesh, name) for name in _MESH_ARRAYS}
    encoded = {n: encodings.encoded(a, ()) for n, a in given.items() if a is not None}
    headers = {name: header for name, (header, _) in encoded.items()}
    absent = np.empty(0, np.uint8)
    arrays = [encoded[name][1] if name in encoded else absent for name in _MESH_ARRAYS]
    return pb.GetGroundTruthMeshResponse(header=pb.MeshHeader(**headers)), arrays


_MESH_ARRAYS = ("vertices_m", "triangles", "semantic_ids", "instance_ids")


def mesh_from_parts(
    parts: Iterable[pb.GetGroundTruthMeshResponse], limit: int = MAX_FRAME_BYTES
) -> TriangleMesh:
    """Return the mesh whose parts these are.

    Args:
        limit: Most bytes that an array may have.

    Raises:
        OaisysError: Parts are missing, contradict each other, or are beyond the limit.
    """
    begun: dict[str, ArrayAssembly] = {}
    for part in parts:
        if part.HasField("header"):
            present = {field.name: header for field, header in part.header.ListFields()}
            begun = {name: ArrayAssembly(header, limit) for name, header in present.items()}
            continue
        chunk = part.chunk
        name = dict(enumerate(_MESH_ARRAYS)).get(chunk.index)
        if name not in begun:
            raise OaisysError(f"a chunk of array {chunk.index} came without its header")
        begun[name].add(chunk)
    if not {"vertices_m", "triangles"} <= begun.keys():
        raise OaisysError("the mesh is incomplete: vertices or triangles are missing")
    arrays = {name: assembly.array() for name, assembly in begun.items()}
    return TriangleMesh(**arrays)


_HEIGHT_ARRAYS = ("ground_height_m", "surface_height_m")


def height_grid_to_message(
    grid: HeightGrid,
) -> tuple[pb.GetHeightFieldResponse, list[NDArray[np.uint8]]]:
    """Return a height grid's header, and the bytes of its arrays in the order of their indices.

    Inverse, once the arrays are sent as `array_chunks`: `heights_from_parts`.
    """
    encoded = [encodings.encoded(array, ()) for array in (grid.ground_m, grid.surface_m)]
    x_m, y_m = grid.origin_xy_m
    header = pb.HeightFieldHeader(
        ground_height_m=encoded[0][0],
        surface_height_m=encoded[1][0],
        origin_x_m=x_m,
        origin_y_m=y_m,
        spacing_m=grid.spacing_m,
    )
    return pb.GetHeightFieldResponse(header=header), [data for _, data in encoded]


def heights_from_parts(
    parts: Iterable[pb.GetHeightFieldResponse], limit: int = MAX_FRAME_BYTES
) -> HeightGrid:
    """Return the height grid whose parts these are.

    Args:
        limit: Most bytes that an array may have.

    Raises:
        OaisysError: Parts are missing, contradict each other, or are beyond the limit.
    """
    header: pb.HeightFieldHeader | None = None
    begun: list[ArrayAssembly] = []
    for part in parts:
        if part.HasField("header"):
            header = part.header
            begun = [ArrayAssembly(getattr(header, name), limit) for name in _HEIGHT_ARRAYS]
            continue
        chunk = part.chunk
        if chunk.index >= len(begun):
            raise OaisysError(f"a chunk of array {chunk.index} came without its header")
        begun[chunk.index].add(chunk)
    if header is None:
        raise OaisysError("the height field is incomplete: its header has not come")
    ground_m, surface_m = (assembly.array() for assembly in begun)
    return HeightGrid(ground_m, surface_m, (header.origin_x_m, header.origin_y_m), header.spacing_m)
