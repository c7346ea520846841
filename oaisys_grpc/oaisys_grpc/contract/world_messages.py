"""Answers about a simulator and its world: description, mesh, heights, objects; in pairs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
    Extent,
    Georeference,
    GroupCount,
    HeightGrid,
    HeightQuery,
    ImuInfo,
    LidarInfo,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    SceneObject,
    SensorInfo,
    SimulatorInfo,
    TriangleMesh,
)
from oaisys_grpc.contract import arrays
from oaisys_grpc.contract.arrays import MAX_FRAME_BYTES, AnyArray, ArrayAssembly
from oaisys_grpc.contract.conversion import Conversion, RecordConversion, each
from oaisys_grpc.contract.metadata import POSE, VECTOR, metadata_to_proto, names
from oaisys_grpc.contract.sample_messages import INTRINSICS, MATRIX
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


def extent_to_proto(extent_m: Extent) -> pb.StageExtent:
    """Return the message of (min_x, min_y, max_x, max_y); inverse: `extent_from_proto`."""
    x0, y0, x1, y1 = extent_m
    return pb.StageExtent(min_x_m=x0, min_y_m=y0, max_x_m=x1, max_y_m=y1)


def extent_from_proto(message: pb.StageExtent) -> Extent:
    """Return an extent."""
    return message.min_x_m, message.min_y_m, message.max_x_m, message.max_y_m


_INFO = RecordConversion(
    SimulatorInfo,
    pb.GetSimulatorInfoResponse,
    renamed={"stage_extent_m": "stage_extent"},
    stage_extent_m=Conversion(extent_to_proto, extent_from_proto),
    rig_pose=POSE,
    sensors=each(
        RecordConversion(SensorInfo, pb.Sensor, intrinsics=INTRINSICS, T_base_camera=MATRIX)
    ),
    lidars=each(RecordConversion(LidarInfo, pb.Lidar, T_base_lidar=MATRIX)),
    imus=each(RecordConversion(ImuInfo, pb.Imu, T_base_imu=MATRIX)),
    group_counts=each(RecordConversion(GroupCount, pb.GroupCount)),
    georeference=RecordConversion(Georeference, pb.Georeference),
)
info_to_proto, info_from_proto = _INFO.to_proto, _INFO.from_proto


def mesh_to_message(
    mesh: TriangleMesh,
) -> tuple[pb.GetGroundTruthMeshResponse, list[NDArray[np.uint8]]]:
    """Return a mesh's header, and the bytes of its arrays in the order of their indices.

    Inverse, once the arrays are sent as `array_chunks`: `mesh_from_parts`.
    """
    given = {name: getattr(mesh, name) for name in _MESH_ARRAYS}
    encoded = {n: arrays.encode(a, ()) for n, a in given.items() if a is not None}
    headers = {name: header for name, (header, _) in encoded.items()}
    absent = np.empty(0, np.uint8)
    data = [encoded[name][1] if name in encoded else absent for name in _MESH_ARRAYS]
    return pb.GetGroundTruthMeshResponse(header=pb.MeshHeader(**headers)), data


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
    _, arrays_by_name = _assemble(parts, _MESH_ARRAYS, ("vertices_m", "triangles"), limit)
    return TriangleMesh(**arrays_by_name)


_HEIGHT_ARRAYS = ("ground_height_m", "surface_height_m")


def height_field_header(
    shape: tuple[int, int], origin_xy_m: tuple[float, float], spacing_m: float
) -> pb.HeightFieldHeader:
    """Return the header of a height grid; the arrays follow as `array_chunks`.

    Inverse: `heights_from_parts`.

    Args:
        shape: Rows and columns.
        origin_xy_m: Centre of cell [0, 0].
        spacing_m: Edge of a cell.
    """
    array = arrays.raw_header_of(np.dtype("<f4"), shape)
    return pb.HeightFieldHeader(
        ground_height_m=array,
        surface_height_m=array,
        origin_x_m=origin_xy_m[0],
        origin_y_m=origin_xy_m[1],
        spacing_m=spacing_m,
    )


def heights_from_parts(
    parts: Iterable[pb.GetHeightFieldResponse], limit: int = MAX_FRAME_BYTES
) -> HeightGrid:
    """Return the height grid whose parts these are.

    Args:
        limit: Most bytes that an array may have.

    Raises:
        OaisysError: Parts are missing, contradict each other, or are beyond the limit.
    """
    header, heights_m = _assemble(parts, _HEIGHT_ARRAYS, _HEIGHT_ARRAYS, limit)
    ground_m, surface_m = (heights_m[name] for name in _HEIGHT_ARRAYS)
    return HeightGrid(ground_m, surface_m, (header.origin_x_m, header.origin_y_m), header.spacing_m)


def _assemble(
    parts: Iterable[Any], names: Sequence[str], required: Sequence[str], limit: int
) -> tuple[Any, dict[str, AnyArray]]:
    """Return the header in a stream of arrays, and the arrays, by the header's names of them.

    Args:
        names: In the order of the chunks' indices.
        required: Those that must have come.
    """
    header: Any = None
    begun: dict[str, ArrayAssembly] = {}
    for part in parts:
        if part.HasField("header"):
            header = part.header
            present = filter(header.HasField, names)
            begun = {name: ArrayAssembly(getattr(header, name), limit) for name in present}
            continue
        name = dict(enumerate(names)).get(part.chunk.index)
        if name not in begun:
            raise OaisysError(f"a chunk of array {part.chunk.index} came without its header")
        begun[name].add(part.chunk)
    if missing := set(required) - begun.keys():
        raise OaisysError(f"the answer is incomplete: {', '.join(sorted(missing))} have not come")
    return header, {name: assembly.array() for name, assembly in begun.items()}


_NUMBERS = Conversion(np.ndarray.tolist, partial(np.array, dtype=np.float64))
_HEIGHTS = RecordConversion(
    HeightQuery,
    pb.QueryHeightResponse,
    ground_height_m=_NUMBERS,
    surface_height_m=_NUMBERS,
    clearance_m=_NUMBERS,
)
heights_to_proto, heights_from_proto = _HEIGHTS.to_proto, _HEIGHTS.from_proto

_QUERY = RecordConversion(
    ObjectQuery,
    pb.ListObjectsRequest,
    kinds=Conversion(tuple, partial(names, field="kinds")),
    groups=Conversion(tuple, partial(names, field="groups")),
    names=Conversion(tuple, partial(names, field="names")),
    low_m=VECTOR,
    high_m=VECTOR,
    limit=Conversion(int, lambda limit: limit or ObjectQuery.limit),
)
query_from_proto = _QUERY.from_proto


def query_to_proto(query: ObjectQuery, metadata: ModuleMetadata | None) -> pb.ListObjectsRequest:
    """Return the request for objects; inverse, but for the metadata: `query_from_proto`."""
    sent = None if metadata is None else metadata_to_proto(metadata)
    return _QUERY.to_proto(query, metadata=sent)


_OBJECT = RecordConversion(
    SceneObject,
    pb.SceneObject,
    pose=POSE,
    low_m=VECTOR,
    high_m=VECTOR,
    box_low_m=VECTOR,
    box_high_m=VECTOR,
)
_PAGE = RecordConversion(ObjectPage, pb.ListObjectsResponse, objects=each(_OBJECT))
page_to_proto, page_from_proto = _PAGE.to_proto, _PAGE.from_proto
