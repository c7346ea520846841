"""The contract's messages and the core's types, in pairs: ``x_to_proto`` and ``x_from_proto``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import checked_pose
from oaisys_core.types import (
    FloatArray,
    HeightQuery,
    ModuleMetadata,
    Odometry,
    PinholeIntrinsics,
    Pose,
    Progress,
    Provenance,
    SensorInfo,
    SimulatorInfo,
)
from oaisys_grpc.contract.typed_metadata import (
    fill,
    joined,
    struct_from_proto,
    struct_to_proto,
    values_of,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

_TYPED = ("environment", "asset", "render")
"""Parts of metadata that come as a typed message, as a Struct, or as both."""


def pose_to_proto(pose: Pose) -> pb.Pose:
    """Return the message of a pose; inverse: `pose_from_proto`."""
    px, py, pz = pose.position_m
    x, y, z, w = pose.quat_xyzw
    return pb.Pose(
        position_m=pb.Vector3(x=px, y=py, z=pz), orientation=pb.Quaternion(x=x, y=y, z=z, w=w)
    )


def pose_from_proto(message: pb.Pose) -> Pose:
    """Return the pose exactly as it was sent; `metadata_from_proto` checks those it takes."""
    p, q = message.position_m, message.orientation
    return Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def metadata_to_proto(metadata: ModuleMetadata) -> pb.ModuleMetadata:
    """Return the message of a step's metadata, typed as far as it goes.

    Inverse: `metadata_from_proto`.

    Raises:
        InvalidInputError: A value is neither JSON nor, in the part ``sensor``, a pose.
    """
    message = pb.ModuleMetadata()
    if metadata.sensor is not None:
        message.sensor.SetInParent()
    settings = dict(metadata.sensor or {})
    if "pose" in settings:
        pose = settings.pop("pose")
        if not isinstance(pose, Pose):
            raise InvalidInputError("metadata.sensor.pose", pose, "a Pose")
        message.sensor.pose.CopyFrom(pose_to_proto(pose))
    settings = fill(message.sensor, settings, ["cameras"]) if settings else settings
    if settings:
        message.sensor.settings.CopyFrom(struct_to_proto(settings, "metadata.sensor"))
    for name in _TYPED:
        part = metadata.part(name)
        if part is None:
            continue
        typed = getattr(message, f"typed_{name}")
        rest = fill(typed, part, typed.DESCRIPTOR.fields_by_name)
        if rest or not part:
            getattr(message, name).CopyFrom(struct_to_proto(rest, f"metadata.{name}"))
    if metadata.custom:
        message.custom.CopyFrom(struct_to_proto(metadata.custom, "metadata.custom"))
    return message


def metadata_from_proto(message: pb.ModuleMetadata) -> ModuleMetadata:
    """Return a step's metadata; an absent part stays absent.

    Raises:
        InvalidInputError: The pose is none or among the other settings, or a key came both typed
            and in a Struct.
    """
    parts: dict[str, Any] = {}
    if message.HasField("sensor"):
        typed = values_of(pb.SensorMetadata(cameras=message.sensor.cameras))
        settings = struct_from_proto(message.sensor.settings)
        parts["sensor"] = joined("metadata.sensor", settings, typed)
        if "pose" in parts["sensor"]:
            received = parts["sensor"]["pose"]
            raise InvalidInputError("metadata.sensor.settings.pose", received, "the field pose")
        if message.sensor.HasField("pose"):
            pose = pose_from_proto(message.sensor.pose)
            checked_pose(pose.position_m, pose.quat_xyzw, "metadata.sensor.pose")
            parts["sensor"]["pose"] = pose
    present = {field.name for field, _ in message.ListFields()}
    for name in _TYPED:
        if present & {name, f"typed_{name}"}:
            typed = values_of(getattr(message, f"typed_{name}"))
            open_ended = struct_from_proto(getattr(message, name))
            parts[name] = joined(f"metadata.{name}", open_ended, typed)
    if message.HasField("custom"):
        parts["custom"] = struct_from_proto(message.custom)
    return ModuleMetadata(**parts)


def intrinsics_to_proto(intrinsics: PinholeIntrinsics) -> pb.Intrinsics:
    """Return the message of a camera's intrinsics; inverse: `intrinsics_from_proto`."""
    values = {name: getattr(intrinsics, name) for name in _INTRINSICS}
    return pb.Intrinsics(**values, distortion=intrinsics.distortion)


def intrinsics_from_proto(message: pb.Intrinsics) -> PinholeIntrinsics:
    """Return a camera's intrinsics."""
    values = {name: getattr(message, name) for name in _INTRINSICS}
    return PinholeIntrinsics(**values, distortion=tuple(message.distortion))


_INTRINSICS = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")


def odometry_to_proto(odometry: Odometry | None) -> pb.Odometry | None:
    """Return the message of an odometry; inverse: `odometry_from_proto`."""
    if odometry is None:
        return None
    pose = pose_to_proto(odometry.pose)
    return pb.Odometry(pose=pose, sigma_m=odometry.sigma_m, sigma_rad=odometry.sigma_rad)


def odometry_from_proto(message: pb.SampleHeader) -> Odometry | None:
    """Return the odometry in a sample's header, if it has one."""
    if not message.HasField("odometry"):
        return None
    found = message.odometry
    return Odometry(pose_from_proto(found.pose), found.sigma_m, found.sigma_rad)


def provenance_to_proto(provenance: Provenance) -> pb.Provenance:
    """Return the message of a provenance; inverse: `provenance_from_proto`."""
    return pb.Provenance(**{name: getattr(provenance, name) for name in _PROVENANCE})


def provenance_from_proto(message: pb.Provenance) -> Provenance:
    """Return a provenance."""
    return Provenance(**{name: getattr(message, name) for name in _PROVENANCE})


_PROVENANCE = (
    "seed",
    "batch_seed",
    "config_sha256",
    "backend",
    "backend_version",
    "quality",
    "render_samples",
    "device",
    "stage_seed",
    "asset_seed",
    "metadata_json",
    "previous_poses_json",
)


def progress_to_proto(progress: Progress) -> pb.Progress:
    """Return the message of a progress; inverse: `progress_from_proto`."""
    return pb.Progress(
        stage=progress.stage, fraction=progress.fraction, seconds_left=progress.seconds_left
    )


def progress_from_proto(message: pb.Progress) -> Progress:
    """Return a progress."""
    left_s = message.seconds_left if message.HasField("seconds_left") else None
    return Progress(message.stage, message.fraction, left_s)


def matrix_from_proto(values: Sequence[float]) -> FloatArray:
    """Return the (4, 4) float64 transform of 16 row-major values; inverse: `matrix_to_proto`."""
    return np.array(values[:], dtype=np.float64).reshape(4, 4)


def matrix_to_proto(T: FloatArray) -> list[float]:
    """Return a matrix's values, row by row."""
    values: list[float] = np.asarray(T, dtype=np.float64).ravel().tolist()
    return values


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
    )
    if info.stage_extent_m is not None:
        x0, y0, x1, y1 = info.stage_extent_m
        extent = pb.StageExtent(min_x_m=x0, min_y_m=y0, max_x_m=x1, max_y_m=y1)
        message.stage_extent.CopyFrom(extent)
    return message


def info_from_proto(message: pb.GetSimulatorInfoResponse) -> SimulatorInfo:
    """Return a simulator's description."""
    e = message.stage_extent
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
        stage_extent_m=(e.min_x_m, e.min_y_m, e.max_x_m, e.max_y_m) if known else None,
        worker_restarts=message.worker_restarts,
        device=message.device,
    )


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
