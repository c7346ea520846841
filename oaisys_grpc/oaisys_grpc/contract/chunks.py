"""Samples and meshes as streams of small messages, and back; in pairs.

What comes back of a sample's parts is `oaisys_grpc.client.sample_stream`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, NotFoundError, OaisysError
from oaisys_core.types import (
    Frame,
    FrameName,
    HeightGrid,
    PinholeIntrinsics,
    Provenance,
    Sample,
    SampleOutline,
    TriangleMesh,
    early_first,
)
from oaisys_grpc.contract import conversions, encodings
from oaisys_grpc.contract.array_messages import Part, RawChunk, RawGroup, SinglePart
from oaisys_grpc.contract.transfer import (
    CHUNK_BYTES,
    MAX_FRAME_BYTES,
    MAX_MESSAGE_BYTES,
    PLAIN,
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

    def add(self, chunk: pb.Chunk | RawChunk) -> None:
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
) -> Iterator[RawChunk]:
    """Yield an encoded array's bytes in pieces; inverse: `ArrayAssembly`."""
    for offset in range(0, data.size, size):
        yield RawChunk(index, offset, data[offset : offset + size].data)


def sample_to_parts(sample: Sample, transfer: Transfer = PLAIN) -> Iterator[Part]:
    """Yield a sample's header, its frames and its end; inverse: `sample_from_parts`."""

    def parts() -> Iterator[SinglePart]:
        yield sample_header_part(sample.outline, sample.render_time_s)
        index = {id(frame): index for index, frame in enumerate(sample.frames)}
        for frame in early_first(sample.frames):
            yield from frame_parts(frame, index[id(frame)], sample.provenance, transfer)
        yield sample_end_part(sample)

    yield from grouped(parts(), transfer)


def sample_header_part(outline: SampleOutline, render_time_s: float = 0.0) -> pb.SamplePart:
    """Return what goes before a sample's frames."""
    header = pb.SampleHeader(
        batch_id=outline.batch_id,
        sample_id=outline.sample_id,
        rig_pose=conversions.pose_to_proto(outline.rig_pose),
        render_time_s=render_time_s,
        provenance=_provenance(outline.provenance),
        frame_count=len(outline.frames),
        from_cache=outline.from_cache,
        odometry=conversions.odometry_to_proto(outline.odometry),
        frames=[pb.FrameName(sensor=n.sensor, modality=n.modality) for n in outline.frames],
    )
    return pb.SamplePart(sample=header)


def frame_parts(
    frame: Frame, index: int, provenance: Provenance, transfer: Transfer = PLAIN
) -> Iterator[SinglePart]:
    """Yield a frame's header and chunks; ``index`` is its place in its sample.

    Raises:
        InvalidInputError: The client does not take frames as large as this one.
    """
    if frame.data.nbytes > transfer.frame_bytes:
        expected = f"at least {frame.data.nbytes}, which {frame.sensor}/{frame.modality} has"
        raise InvalidInputError("transfer.max_frame_bytes", transfer.frame_bytes, expected)
    header = _frame_header(frame, index, provenance)
    place = place_of(frame.data) if transfer.token else None
    if place is not None:
        header.array.CopyFrom(encodings.raw_header(frame.data))
        header.shared_memory.CopyFrom(place_to_proto(place))
        yield pb.SamplePart(frame=header)
        return
    array, data = encodings.encoded(frame.data, transfer.encodings)
    header.array.CopyFrom(array)
    if data.size <= transfer.inline_bytes:
        header.data = data.tobytes()
        yield pb.SamplePart(frame=header)
        return
    yield pb.SamplePart(frame=header)
    yield from array_chunks(data, index, transfer.chunk_bytes)


def frame_response(sample: Sample, name: FrameName, accepted: Iterable[int]) -> pb.GetFrameResponse:
    """Return one frame of a sample in one message.

    Raises:
        NotFoundError: The sample has no such frame.
        InvalidInputError: It is too large for one message.
    """
    outline = sample.outline
    if name not in outline.frames:
        raise NotFoundError(f"the sample has no frame {name.sensor}/{name.modality}")
    index = outline.frames.index(name)
    header = _frame_header(sample.frames[index], index, sample.provenance)
    array, data = encodings.encoded(sample.frames[index].data, accepted)
    if data.size > MAX_MESSAGE_BYTES:
        expected = f"a frame of at most {MAX_MESSAGE_BYTES} bytes: GetSample sends larger ones"
        raise InvalidInputError("modality", f"{name.modality} of {data.size} bytes", expected)
    header.array.CopyFrom(array)
    header.data = data.tobytes()
    begin = sample_header_part(outline, sample.render_time_s)
    return pb.GetFrameResponse(sample=begin.sample, frame=header)


def grouped(parts: Iterable[SinglePart], transfer: Transfer) -> Iterator[Part]:
    """Yield parts with neighbours put together, for a client that takes them so."""
    group: list[SinglePart] = []
    inline_bytes = chunk_bytes = 0
    for part in parts:
        in_chunk = len(part.data) if isinstance(part, RawChunk) else 0
        inline = 0 if isinstance(part, RawChunk) else len(part.frame.data)
        inline_bytes, chunk_bytes = inline_bytes + inline, chunk_bytes + in_chunk
        if inline_bytes > transfer.inline_bytes or chunk_bytes > transfer.group_bytes:
            yield from _group(group)
            group, inline_bytes, chunk_bytes = [], inline, in_chunk
        group.append(part)
        if not transfer.grouped or in_chunk > transfer.group_bytes:
            yield from _group(group)
            group, inline_bytes, chunk_bytes = [], 0, 0
    yield from _group(group)


def _group(parts: list[SinglePart]) -> Iterator[Part]:
    messages = [part for part in parts if isinstance(part, pb.SamplePart)]
    if len(parts) < 2:
        yield from parts
    elif len(messages) == len(parts):
        yield pb.SamplePart(group=pb.SamplePartGroup(parts=messages))
    else:
        yield RawGroup(tuple(parts))


def sample_end_part(sample: Sample) -> pb.SamplePart:
    """Return what says that all frames of a sample were sent."""
    end = pb.SampleEnd(
        render_time_s=sample.render_time_s,
        provenance=_provenance(_brief(sample.provenance)),
        finished_monotonic_ns=sample.finished_ns,
    )
    return pb.SamplePart(end=end)


def mesh_to_parts(mesh: TriangleMesh) -> Iterator[pb.GetGroundTruthMeshResponse | RawChunk]:
    """Yield a mesh's header and its arrays' chunks; inverse: `mesh_from_parts`."""
    arrays = {name: getattr(mesh, name) for name in _MESH_ARRAYS}
    encoded = {n: encodings.encoded(a, ()) for n, a in arrays.items() if a is not None}
    headers = {name: header for name, (header, _) in encoded.items()}
    yield pb.GetGroundTruthMeshResponse(header=pb.MeshHeader(**headers))
    for index, name in enumerate(_MESH_ARRAYS):
        if name in encoded:
            yield from array_chunks(encoded[name][1], index)


_MESH_ARRAYS = ("vertices_m", "triangles", "semantic_ids", "instance_ids")


def mesh_from_parts(
    parts: Iterable[pb.GetGroundTruthMeshResponse | RawChunk], limit: int = MAX_FRAME_BYTES
) -> TriangleMesh:
    """Return the mesh whose parts these are.

    Args:
        limit: Most bytes that an array may have.

    Raises:
        OaisysError: Parts are missing, contradict each other, or are beyond the limit.
    """
    begun: dict[str, ArrayAssembly] = {}
    for part in parts:
        if isinstance(part, pb.GetGroundTruthMeshResponse) and part.HasField("header"):
            present = {field.name: header for field, header in part.header.ListFields()}
            begun = {name: ArrayAssembly(header, limit) for name, header in present.items()}
            continue
        chunk = part if isinstance(part, RawChunk) else part.chunk
        name = dict(enumerate(_MESH_ARRAYS)).get(chunk.index)
        if name not in begun:
            raise OaisysError(f"a chunk of array {chunk.index} came without its header")
        begun[name].add(chunk)
    if not {"vertices_m", "triangles"} <= begun.keys():
        raise OaisysError("the mesh is incomplete: vertices or triangles are missing")
    arrays = {name: assembly.array() for name, assembly in begun.items()}
    return TriangleMesh(**arrays)


_HEIGHT_ARRAYS = ("ground_height_m", "surface_height_m")


def heights_to_parts(grid: HeightGrid) -> Iterator[pb.GetHeightFieldResponse | RawChunk]:
    """Yield a height grid's header and its arrays' chunks; inverse: `heights_from_parts`."""
    encoded = [encodings.encoded(array, ()) for array in (grid.ground_m, grid.surface_m)]
    x_m, y_m = grid.origin_xy_m
    header = pb.HeightFieldHeader(
        ground_height_m=encoded[0][0],
        surface_height_m=encoded[1][0],
        origin_x_m=x_m,
        origin_y_m=y_m,
        spacing_m=grid.spacing_m,
    )
    yield pb.GetHeightFieldResponse(header=header)
    for index, (_, data) in enumerate(encoded):
        yield from array_chunks(data, index)


def heights_from_parts(
    parts: Iterable[pb.GetHeightFieldResponse | RawChunk], limit: int = MAX_FRAME_BYTES
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
        if isinstance(part, pb.GetHeightFieldResponse) and part.HasField("header"):
            header = part.header
            begun = [ArrayAssembly(getattr(header, name), limit) for name in _HEIGHT_ARRAYS]
            continue
        chunk = part if isinstance(part, RawChunk) else part.chunk
        if chunk.index >= len(begun):
            raise OaisysError(f"a chunk of array {chunk.index} came without its header")
        begun[chunk.index].add(chunk)
    if header is None:
        raise OaisysError("the height field is incomplete: its header has not come")
    ground_m, surface_m = (assembly.array() for assembly in begun)
    return HeightGrid(ground_m, surface_m, (header.origin_x_m, header.origin_y_m), header.spacing_m)


_provenance = functools.lru_cache(maxsize=64)(conversions.provenance_to_proto)
"""All frames of a sample have the same, and many samples; what is returned is not to be changed."""


@functools.lru_cache(maxsize=8)
def _brief(provenance: Provenance) -> Provenance:
    """Return it without what may be long, which the sample's header says once for all frames."""
    return replace(provenance, metadata_json="", previous_poses_json="")


@functools.lru_cache(maxsize=64)
def _camera(intrinsics: PinholeIntrinsics) -> pb.FrameHeader:
    """Return what headers of all frames of a camera have in common; it is not to be changed."""
    return pb.FrameHeader(
        intrinsics=conversions.intrinsics_to_proto(intrinsics),
        k=conversions.matrix_to_proto(intrinsics.K),
    )


def _frame_header(frame: Frame, index: int, provenance: Provenance) -> pb.FrameHeader:
    header = pb.FrameHeader(
        sensor=frame.sensor,
        modality=frame.modality,
        t_map_camera=conversions.matrix_to_proto(frame.T_map_camera),
        provenance=_provenance(_brief(provenance)),
        index=index,
    )
    header.MergeFrom(_camera(frame.intrinsics))
    return header


def frame_from_header(header: pb.FrameHeader, data: AnyArray) -> Frame:
    """Return a frame whose bytes have all come."""
    return Frame(
        sensor=header.sensor,
        modality=header.modality,
        data=data,
        intrinsics=conversions.intrinsics_from_proto(header.intrinsics),
        T_map_camera=conversions.matrix_from_proto(header.t_map_camera),
    )
