"""Answers about a simulator and its world: description, mesh, heights, objects; in pairs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import OaisysError
from oaisys_core.types import (
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
from oaisys_grpc.contract.metadata import (
    metadata_to_proto,
    names,
    pose_from_proto,
    pose_to_proto,
    vector_from_proto,
    vector_to_proto,
)
from oaisys_grpc.contract.sample_messages import (
    intrinsics_from_proto,
    intrinsics_to_proto,
    matrix_from_proto,
    matrix_to_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

Extent = tuple[float, float, float, float]


def info_to_proto(info: SimulatorInfo) -> pb.GetSimulatorInfoResponse:
    """Return the message of a simulator's description; inverse: `info_from_proto`."""
    message = pb.GetSimulatorInfoResponse(
        backend=info.backend,
        backend_version=info.backend_version,
        seed=info.seed,
        config_sha256=info.config_sha256,
        quality=info.quality,
        sensors=[_sensor_to_proto(sensor) for sensor in info.sensors],
        semantic_labels=dict(info.semantic_labels),
        batch_id=info.batch_id,
        sample_id=info.sample_id,
        worker_restarts=info.worker_restarts,
        device=info.device,
        lidars=[
            pb.Lidar(
                name=lidar.name,
                t_base_lidar=matrix_to_proto(lidar.T_base_lidar),
                period_s=lidar.period_s,
                extra_fields=lidar.extra_fields,
            )
            for lidar in info.lidars
        ],
        imus=map(_imu_to_proto, info.imus),
        group_counts=[
            pb.GroupCount(name=count.name, asked=count.asked, placed=count.placed)
            for count in info.group_counts
        ],
    )
    if info.stage_extent_m is not None:
        message.stage_extent.CopyFrom(extent_to_proto(info.stage_extent_m))
    return message


def info_from_proto(message: pb.GetSimulatorInfoResponse) -> SimulatorInfo:
    """Return a simulator's description."""
    known = message.HasField("stage_extent")
    return SimulatorInfo(
        backend=message.backend,
        backend_version=message.backend_version,
        seed=message.seed,
        config_sha256=message.config_sha256,
        quality=message.quality,
        sensors=tuple(_sensor_from_proto(sensor) for sensor in message.sensors),
        semantic_labels=dict(message.semantic_labels),
        batch_id=message.batch_id,
        sample_id=message.sample_id,
        stage_extent_m=extent_from_proto(message.stage_extent) if known else None,
        worker_restarts=message.worker_restarts,
        device=message.device,
        lidars=tuple(
            LidarInfo(
                lidar.name,
                matrix_from_proto(lidar.t_base_lidar),
                lidar.period_s,
                tuple(lidar.extra_fields),
            )
            for lidar in message.lidars
        ),
        imus=tuple(map(_imu_from_proto, message.imus)),
        group_counts=tuple(
            GroupCount(count.name, count.asked, count.placed) for count in message.group_counts
        ),
    )


def _imu_to_proto(imu: ImuInfo) -> pb.Imu:
    return pb.Imu(
        name=imu.name,
        t_base_imu=matrix_to_proto(imu.T_base_imu),
        rate_hz=imu.rate_hz,
        angular_rate_sigma_rad_s=imu.angular_rate_sigma_rad_s,
        specific_force_sigma_m_s2=imu.specific_force_sigma_m_s2,
    )


def _imu_from_proto(message: pb.Imu) -> ImuInfo:
    return ImuInfo(
        message.name,
        matrix_from_proto(message.t_base_imu),
        message.rate_hz,
        message.angular_rate_sigma_rad_s,
        message.specific_force_sigma_m_s2,
    )


def extent_to_proto(extent_m: Extent) -> pb.StageExtent:
    """Return the message of (min_x, min_y, max_x, max_y); inverse: `extent_from_proto`."""
    x0, y0, x1, y1 = extent_m
    return pb.StageExtent(min_x_m=x0, min_y_m=y0, max_x_m=x1, max_y_m=y1)


def extent_from_proto(message: pb.StageExtent) -> Extent:
    """Return an extent."""
    return message.min_x_m, message.min_y_m, message.max_x_m, message.max_y_m


def _sensor_to_proto(sensor: SensorInfo) -> pb.Sensor:
    return pb.Sensor(
        name=sensor.name,
        intrinsics=intrinsics_to_proto(sensor.intrinsics),
        t_base_camera=matrix_to_proto(sensor.T_base_camera),
        modalities=sensor.modalities,
        stereo_baseline_m=sensor.stereo_baseline_m,
    )


def _sensor_from_proto(message: pb.Sensor) -> SensorInfo:
    return SensorInfo(
        name=message.name,
        intrinsics=intrinsics_from_proto(message.intrinsics),
        T_base_camera=matrix_from_proto(message.t_base_camera),
        modalities=tuple(message.modalities),
        stereo_baseline_m=message.stereo_baseline_m,
    )


def mesh_to_message(
    mesh: TriangleMesh,
) -> tuple[pb.GetGroundTruthMeshResponse, list[NDArray[np.uint8]]]:
    """Return a mesh's header, and the bytes of its arrays in the order of their indices.

    Inverse, once the arrays are sent as `array_chunks`: `mesh_from_parts`.
    """
    given = {name: getattr(mesh, name) for name in _MESH_ARRAYS}
    encoded = {n: arrays.encoded(a, ()) for n, a in given.items() if a is not None}
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
    _, arrays_by_name = _assembled(parts, _MESH_ARRAYS, ("vertices_m", "triangles"), limit)
    return TriangleMesh(**arrays_by_name)


_HEIGHT_ARRAYS = ("ground_height_m", "surface_height_m")


def height_grid_to_message(
    grid: HeightGrid,
) -> tuple[pb.GetHeightFieldResponse, list[NDArray[np.uint8]]]:
    """Return a height grid's header, and the bytes of its arrays in the order of their indices.

    Inverse, once the arrays are sent as `array_chunks`: `heights_from_parts`.
    """
    encoded = [arrays.encoded(array, ()) for array in (grid.ground_m, grid.surface_m)]
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
    header, heights_m = _assembled(parts, _HEIGHT_ARRAYS, _HEIGHT_ARRAYS, limit)
    ground_m, surface_m = (heights_m[name] for name in _HEIGHT_ARRAYS)
    return HeightGrid(ground_m, surface_m, (header.origin_x_m, header.origin_y_m), header.spacing_m)


def _assembled(
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


def heights_to_proto(heights: HeightQuery) -> pb.QueryHeightResponse:
    """Return the message of an answer about heights; inverse: `heights_from_proto`."""
    return pb.QueryHeightResponse(
        ground_height_m=heights.ground_height_m,
        surface_height_m=heights.surface_height_m,
        clearance_m=heights.clearance_m,
    )


def heights_from_proto(message: pb.QueryHeightResponse) -> HeightQuery:
    """Return an answer about heights."""
    return HeightQuery(
        ground_height_m=np.array(message.ground_height_m, dtype=np.float64),
        surface_height_m=np.array(message.surface_height_m, dtype=np.float64),
        clearance_m=np.array(message.clearance_m, dtype=np.float64),
    )


def query_to_proto(query: ObjectQuery, metadata: ModuleMetadata | None) -> pb.ListObjectsRequest:
    """Return the request for objects; inverse, but for the metadata: `query_from_proto`."""
    message = pb.ListObjectsRequest(
        kinds=query.kinds,
        groups=query.groups,
        names=query.names,
        instance_ids=query.instance_ids,
        after_instance_id=query.after_instance_id,
        limit=query.limit,
    )
    if query.low_m is not None:
        message.low_m.CopyFrom(vector_to_proto(query.low_m))
    if query.high_m is not None:
        message.high_m.CopyFrom(vector_to_proto(query.high_m))
    if metadata is not None:
        message.metadata.CopyFrom(metadata_to_proto(metadata))
    return message


def query_from_proto(message: pb.ListObjectsRequest) -> ObjectQuery:
    """Return which objects are asked for."""
    return ObjectQuery(
        kinds=names(message.kinds, "kinds"),
        groups=names(message.groups, "groups"),
        names=names(message.names, "names"),
        instance_ids=tuple(message.instance_ids),
        low_m=vector_from_proto(message.low_m) if message.HasField("low_m") else None,
        high_m=vector_from_proto(message.high_m) if message.HasField("high_m") else None,
        after_instance_id=message.after_instance_id,
        limit=message.limit or ObjectQuery.limit,
    )


def page_to_proto(page: ObjectPage) -> pb.ListObjectsResponse:
    """Return the message of a page of objects; inverse: `page_from_proto`."""
    return pb.ListObjectsResponse(
        objects=map(_object_to_proto, page.objects),
        total=page.total,
        next_after_instance_id=page.next_after_instance_id,
    )


def page_from_proto(message: pb.ListObjectsResponse) -> ObjectPage:
    """Return a page of objects."""
    objects = tuple(map(_object_from_proto, message.objects))
    return ObjectPage(objects, message.total, message.next_after_instance_id)


_PLAIN = ("instance_id", "name", "kind", "group", "label", "semantic_id", "scale")
"""Attributes of an object that its message holds as they are."""


def _object_to_proto(thing: SceneObject) -> pb.SceneObject:
    return pb.SceneObject(
        **{name: getattr(thing, name) for name in _PLAIN},
        pose=pose_to_proto(thing.pose),
        low_m=vector_to_proto(thing.low_m),
        high_m=vector_to_proto(thing.high_m),
    )


def _object_from_proto(message: pb.SceneObject) -> SceneObject:
    return SceneObject(
        **{name: getattr(message, name) for name in _PLAIN},
        pose=pose_from_proto(message.pose),
        low_m=vector_from_proto(message.low_m),
        high_m=vector_from_proto(message.high_m),
    )
