"""Samples and meshes as streams of small messages, and back; in pairs.

Chunks of 1 MiB keep every message below gRPC's default limit of 4 MiB, whatever an image's size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import Frame, FrameName, Provenance, Sample, SampleOutline, TriangleMesh
from oaisys_grpc import conversions
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

CHUNK_BYTES = 1 << 20

AnyArray = NDArray[Any]

_DTYPES: dict[int, np.dtype[Any]] = {
    pb.DATA_TYPE_UINT8: np.dtype("<u1"),
    pb.DATA_TYPE_UINT16: np.dtype("<u2"),
    pb.DATA_TYPE_UINT32: np.dtype("<u4"),
    pb.DATA_TYPE_INT32: np.dtype("<i4"),
    pb.DATA_TYPE_FLOAT32: np.dtype("<f4"),
    pb.DATA_TYPE_FLOAT64: np.dtype("<f8"),
}
_DATA_TYPES: dict[np.dtype[Any], Any] = {dtype: data_type for data_type, dtype in _DTYPES.items()}


class ArrayAssembly:
    """Puts an array together from its header and its chunks, in one allocation."""

    def __init__(self, header: pb.ArrayHeader) -> None:
        """Check the header and allocate.

        Raises:
            OaisysError: The header contradicts itself or says what this client cannot read.
        """
        dtype = _DTYPES.get(header.data_type)
        if dtype is None or header.encoding != pb.ENCODING_RAW:
            raise OaisysError(
                f"cannot read an array of data type {header.data_type}, encoding {header.encoding}"
            )
        if math.prod(header.shape) * dtype.itemsize != header.byte_size:
            raise OaisysError(f"shape {list(header.shape)} is not {header.byte_size} bytes")
        self._bytes = np.empty(header.byte_size, dtype=np.uint8)
        self._array: AnyArray = self._bytes.view(dtype).reshape(tuple(header.shape))
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
            OaisysError: Pieces are missing.
        """
        if not self.is_complete:
            raise OaisysError(f"{self._received} of {self._bytes.size} bytes came")
        return self._array


def array_header(array: AnyArray) -> pb.ArrayHeader:
    """Return the header of an array of one of the contract's data types."""
    return pb.ArrayHeader(
        data_type=_DATA_TYPES[array.dtype.newbyteorder("<")],
        shape=array.shape,
        encoding=pb.ENCODING_RAW,
        byte_size=array.nbytes,
    )


def array_chunks(array: AnyArray, index: int) -> Iterator[pb.Chunk]:
    """Yield an array's bytes; inverse: `ArrayAssembly`."""
    raw = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1).view(np.uint8)
    for offset in range(0, raw.size, CHUNK_BYTES):
        data = raw[offset : offset + CHUNK_BYTES].tobytes()
        yield pb.Chunk(index=index, offset=offset, data=data)


def sample_to_parts(sample: Sample) -> Iterator[pb.SamplePart]:
    """Yield a sample's header, its frames and its end; inverse: `sample_from_parts`."""
    yield sample_header_part(outline_of(sample), sample.render_time_s)
    for index, frame in enumerate(sample.frames):
        yield from frame_parts(frame, index, sample.provenance)
    yield sample_end_part(sample)


def sample_header_part(outline: SampleOutline, render_time_s: float = 0.0) -> pb.SamplePart:
    """Return what goes before a sample's frames."""
    header = pb.SampleHeader(
        batch_id=outline.batch_id,
        sample_id=outline.sample_id,
        rig_pose=conversions.pose_to_proto(outline.rig_pose),
        render_time_s=render_time_s,
        provenance=conversions.provenance_to_proto(outline.provenance),
        frame_count=len(outline.frames),
        from_cache=outline.from_cache,
        frames=[pb.FrameName(sensor=n.sensor, modality=n.modality) for n in outline.frames],
    )
    return pb.SamplePart(sample=header)


def frame_parts(frame: Frame, index: int, provenance: Provenance) -> Iterator[pb.SamplePart]:
    """Yield a frame's header and chunks; ``index`` is its place in its sample."""
    header = _frame_header(frame, conversions.provenance_to_proto(provenance))
    header.index = index
    yield pb.SamplePart(frame=header)
    for chunk in array_chunks(frame.data, index):
        yield pb.SamplePart(chunk=chunk)


def sample_end_part(sample: Sample) -> pb.SamplePart:
    """Return what says that all frames of a sample were sent."""
    provenance = conversions.provenance_to_proto(sample.provenance)
    return pb.SamplePart(
        end=pb.SampleEnd(render_time_s=sample.render_time_s, provenance=provenance)
    )


def outline_of(sample: Sample) -> SampleOutline:
    """Return what was known of a sample before its frames were rendered."""
    return SampleOutline(
        batch_id=sample.batch_id,
        sample_id=sample.sample_id,
        rig_pose=sample.rig_pose,
        frames=tuple(FrameName(frame.sensor, frame.modality) for frame in sample.frames),
        provenance=sample.provenance,
        from_cache=sample.from_cache,
    )


def mesh_to_parts(mesh: TriangleMesh) -> Iterator[pb.GetGroundTruthMeshResponse]:
    """Yield a mesh's header and its arrays' chunks; inverse: `mesh_from_parts`."""
    arrays = {name: getattr(mesh, name) for name in _MESH_ARRAYS}
    headers = {name: array_header(a) for name, a in arrays.items() if a is not None}
    yield pb.GetGroundTruthMeshResponse(header=pb.MeshHeader(**headers))
    for index, array in enumerate(arrays.values()):
        if array is not None:
            for chunk in array_chunks(array, index):
                yield pb.GetGroundTruthMeshResponse(chunk=chunk)


_MESH_ARRAYS = ("vertices_m", "triangles", "semantic_ids", "instance_ids")


def mesh_from_parts(parts: Iterable[pb.GetGroundTruthMeshResponse]) -> TriangleMesh:
    """Return the mesh whose parts these are.

    Raises:
        OaisysError: Parts are missing or contradict each other.
    """
    begun: dict[str, ArrayAssembly] = {}
    for part in parts:
        if part.WhichOneof("part") == "header":
            present = {field.name: header for field, header in part.header.ListFields()}
            begun = {name: ArrayAssembly(header) for name, header in present.items()}
            continue
        assembly = begun.get(_MESH_ARRAYS[part.chunk.index])
        if assembly is None:
            raise OaisysError(f"a chunk of array {part.chunk.index} came without its header")
        assembly.add(part.chunk)
    if not {"vertices_m", "triangles"} <= begun.keys():
        raise OaisysError("the mesh is incomplete: vertices or triangles are missing")
    arrays = {name: assembly.array() for name, assembly in begun.items()}
    return TriangleMesh(**arrays)


def _frame_header(frame: Frame, provenance: pb.Provenance) -> pb.FrameHeader:
    return pb.FrameHeader(
        sensor=frame.sensor,
        modality=frame.modality,
        array=array_header(frame.data),
        intrinsics=conversions.intrinsics_to_proto(frame.intrinsics),
        t_map_camera=conversions.matrix_to_proto(frame.T_map_camera),
        k=conversions.matrix_to_proto(frame.intrinsics.K),
        provenance=provenance,
    )


def frame_from_header(header: pb.FrameHeader, data: AnyArray) -> Frame:
    """Return a frame whose bytes have all come."""
    return Frame(
        sensor=header.sensor,
        modality=header.modality,
        data=data,
        intrinsics=conversions.intrinsics_from_proto(header.intrinsics),
        T_map_camera=conversions.matrix_from_proto(header.t_map_camera),
    )
