"""A running simulator and its sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from oaisys_core.types.arrays import FloatArray, ShortRepr
from oaisys_core.types.cameras import PinholeIntrinsics
from oaisys_core.types.georeference import Georeference
from oaisys_core.types.poses import Pose


@dataclass(frozen=True, repr=False)
class SensorInfo(ShortRepr):
    """A camera of the rig.

    Attributes:
        T_base_camera: (4, 4) pose of the optical frame in ``base_link``.
        modalities: The modalities that it renders.
        stereo_baseline_m: Distance of a right stereo camera from the left one; 0 for all others.
    """

    name: str
    intrinsics: PinholeIntrinsics
    T_base_camera: FloatArray
    modalities: tuple[str, ...]
    stereo_baseline_m: float = 0.0


@dataclass(frozen=True, repr=False)
class LidarInfo(ShortRepr):
    """A lidar of the rig.

    Attributes:
        T_base_lidar: (4, 4) pose of the lidar in ``base_link``.
        period_s: Duration of a scan.
        extra_fields: Fields of its points beyond the usual ones, see `point_dtype`.
    """

    name: str
    T_base_lidar: FloatArray
    period_s: float
    extra_fields: tuple[str, ...] = ()


@dataclass(frozen=True, repr=False)
class ImuInfo(ShortRepr):
    """An inertial measurement unit of the rig.

    Attributes:
        T_base_imu: (4, 4) pose of the IMU in ``base_link``.
        rate_hz: Measurements per second.
        angular_rate_sigma_rad_s, specific_force_sigma_m_s2: Standard deviation of the white noise
            of each axis in one measurement.
    """

    name: str
    T_base_imu: FloatArray
    rate_hz: float
    angular_rate_sigma_rad_s: float = 0.0
    specific_force_sigma_m_s2: float = 0.0


@dataclass(frozen=True)
class GroupCount:
    """How many objects of a group stand in a world.

    Attributes:
        name: Name of the group; `rocks.0` for the first of `assets.rocks`, which is only there if
            some had no room.
        asked: Number drawn from its range of counts, times the factors of the metadata.
        placed: Number for which there was room where its densities are not 0.
    """

    name: str
    asked: int
    placed: int


@dataclass(frozen=True)
class SimulatorInfo:
    """A running simulator: its version, its sensors, its current batch and sample.

    Attributes:
        sensors: The cameras.
        lidars: The lidars.
        imus: The IMUs.
        semantic_labels: Name by semantic id.
        stage_extent_m: (min_x, min_y, max_x, max_y) of the ground, or None before the first batch.
        worker_restarts: Number of times that a server has replaced a rendering process that died.
        device: Device that renders colour.
        group_counts: The numbers of objects of each group of the current batch.
        rig_pose: Where the rig is: its start pose until the first sample of a batch; None before
            the first batch, or where a server does not tell.
        odometry_drifts: Whether samples have an estimate of the rig's pose that drifts.
        georeference: Where the ground of the current batch lies on its body; None if it is of no
            place.
    """

    backend: str
    backend_version: str
    seed: int
    config_sha256: str
    quality: str
    sensors: tuple[SensorInfo, ...]
    semantic_labels: Mapping[int, str]
    batch_id: int
    sample_id: int
    stage_extent_m: tuple[float, float, float, float] | None
    worker_restarts: int = 0
    device: str = "cpu"
    lidars: tuple[LidarInfo, ...] = ()
    imus: tuple[ImuInfo, ...] = ()
    group_counts: tuple[GroupCount, ...] = ()
    rig_pose: Pose | None = None
    odometry_drifts: bool = False
    georeference: Georeference | None = None
