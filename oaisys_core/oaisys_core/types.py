"""Plain typed data that crosses package borders: poses, cameras, frames, samples, meshes.

Nothing here knows Blender, gRPC or ROS. Arrays are numpy; units and frames are in the names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import extensions
from oaisys_core.errors import did_you_mean

FloatArray = NDArray[np.float64]

MAX_IMAGE_PX = 100_000_000
"""Largest number of pixels of an image."""

RGB = "rgb"
DEPTH = "depth"
SEMANTIC_0 = "semantic_0"
INSTANCE = "instance"

RANGE = "range"
NORMAL = "normal"
FLOW = "flow"
ALBEDO = "albedo"
DISPARITY = "disparity"

COLORS = frozenset({RGB, ALBEDO})
"""Modalities that are rendered; all others are cast, and depend neither on light nor on quality."""


def is_rendered(modality: str, quality: str, passes: Collection[str] | None) -> bool:
    """Return whether samples have the images that a camera has of a modality.

    Args:
        modality: Its name.
        quality: ``render.quality``; ``geometry`` has no colour.
        passes: ``render.passes``; None for all.
    """
    is_left_out = quality == "geometry" and modality in COLORS
    return not is_left_out and (passes is None or modality in passes)


POINTS = "points"
"""Modality of lidars, whose data are points rather than an image."""


class ModalitySpec(NamedTuple):
    """The type of a modality's pixels; ``channels`` is 1 for (H, W) images."""

    dtype: np.dtype[Any]
    channels: int


_MODALITIES: Mapping[str, ModalitySpec] = {
    RGB: ModalitySpec(np.dtype(np.uint8), 3),
    DEPTH: ModalitySpec(np.dtype(np.float32), 1),
    RANGE: ModalitySpec(np.dtype(np.float32), 1),
    INSTANCE: ModalitySpec(np.dtype(np.uint32), 1),
    NORMAL: ModalitySpec(np.dtype(np.float32), 3),
    FLOW: ModalitySpec(np.dtype(np.float32), 2),
    ALBEDO: ModalitySpec(np.dtype(np.uint8), 3),
    DISPARITY: ModalitySpec(np.dtype(np.float32), 1),
}
_SEMANTIC = ModalitySpec(np.dtype(np.uint16), 1)


def modality_spec(modality: str) -> ModalitySpec:
    """Return the type of a modality's pixels.

    * ``rgb``: sRGB colour. ``albedo``: sRGB-encoded reflectance, without light and effects.
    * ``depth``: planar z in metres, of a fisheye the same as ``range``; ``range``: metres along the
      ray; ``+inf`` where nothing is hit.
    * ``semantic_0`` to ``semantic_9``: label ids by level. ``instance``: object ids, 0 for none.
    * ``normal``: unit normals in the optical frame, towards the camera; 0 where nothing is hit.
    * ``flow``: motion (du, dv) in pixels since the sensor's previous sample of the surface that a
      pixel shows; NaN where it was not in front of the camera or where a lens's distortion does
      not hold (twice as far from the axis as the corners, or folded), or without a previous sample.
    * ``disparity``: distance in pixels between the images of a stereo pair; 0 where nothing is hit.

    Raises:
        KeyError: There is no such modality.
    """
    if semantic_level(modality) is not None:
        return _SEMANTIC
    if extensions.is_installed(extensions.PASSES, modality, _MODALITIES):
        spec: ModalitySpec = extensions.load(extensions.PASSES, modality).spec
        return spec
    return _MODALITIES[modality]


def expected_modality(received: str) -> str:
    """Return the text after "expected" in the error about a modality that does not exist."""
    levels = [f"semantic_{level}" for level in range(10)]
    passes = extensions.names(extensions.PASSES)
    hint = did_you_mean(received, [*_MODALITIES, *levels, *passes])
    built_in = ", ".join(_MODALITIES)
    installed = f"{', '.join(sorted(passes))}" if passes else "none is installed"
    return f"{built_in}, semantic_0 to semantic_9, or an installed pass ({installed}){hint}"


def semantic_level(modality: str) -> int | None:
    """Return the level of ``semantic_N``, None for any other modality."""
    match = re.fullmatch(r"semantic_([0-9])", modality)
    return None if match is None else int(match[1])


class ShortRepr:
    """Base of dataclasses with arrays (``repr=False``): shows the arrays' types and shapes only."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{f.name}={_shown(getattr(self, f.name))}" for f in fields(self))  # type: ignore[arg-type]
        return f"{type(self).__name__}({shown})"


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    return repr(value)


@dataclass(frozen=True)
class Pose:
    """Position and orientation of a body frame in ``map`` (REP-103: x forward, y left, z up).

    Attributes:
        position_m: (x, y, z) in metres.
        quat_xyzw: Unit quaternion that rotates body coordinates into ``map``.
    """

    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


PLUMB_BOB = "plumb_bob"
"""ROS's name of a pinhole camera with Brown-Conrady distortion of five coefficients."""

EQUIDISTANT = "equidistant"
"""ROS's name of OpenCV's fisheye camera (Kannala-Brandt) of four coefficients."""


@dataclass(frozen=True)
class PinholeIntrinsics:
    """A pinhole or fisheye camera in OpenCV's convention: pixel centres at integers.

    Attributes:
        width_px, height_px: Image size.
        fx_px, fy_px: Focal lengths in pixels; of a fisheye, pixels per radian on the axis.
        cx_px, cy_px: Principal point; (319.5, 239.5) is the centre of a 640x480 image.
        distortion: Brown-Conrady coefficients (k1, k2, p1, p2, k3) in the order of OpenCV and of
            ROS's ``plumb_bob``; of a fisheye, the coefficients (k1, k2, k3, k4) of OpenCV's
            ``fisheye``; empty for none.
        distortion_model: `PLUMB_BOB`, or `EQUIDISTANT` for a fisheye.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    distortion_model: str = PLUMB_BOB

    @property
    def is_fisheye(self) -> bool:
        """Whether it is a fisheye, whose depth images have ranges along the rays."""
        return self.distortion_model == EQUIDISTANT

    @property
    def is_rectilinear(self) -> bool:
        """Whether it images straight lines as straight lines: a pinhole without distortion."""
        return not self.is_fisheye and not any(self.distortion)

    @property
    def K(self) -> FloatArray:  # noqa: N802 - the field's name for the camera matrix
        """The 3x3 camera matrix."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )


@dataclass(frozen=True)
class Provenance:
    """All that is needed to render a frame again, byte for byte in depth and labels.

    Attributes:
        seed: Root seed of the simulation's random draws.
        batch_seed: Seed that this batch was drawn from.
        config_sha256: Hash of the canonical configuration.
        backend: ``blender`` or ``analytic``.
        backend_version: Version of Blender, or of this package for ``analytic``.
        quality: Name of the quality preset.
        render_samples: Samples per pixel of the RGB pass, the fewest of all cameras (0: none).
        device: Device that rendered colour, such as ``cpu``.
        stage_seed: Seed of ground and materials; another one on a reused stage.
        asset_seed: Seed of the objects; another one if they were kept from an earlier batch.
        metadata_json: Metadata with which a new batch reaches the state of this one, by module and
            without the pose, as JSON; empty if it is not known.
        previous_poses_json: Pose of the rig at the previous sample of each sensor whose images
            depend on it (flow, motion blur), as JSON by the sensor's name; empty for none.
        exposures_json: Exposure of each colour image in stops, fixed or metered, as JSON by the
            camera's name; empty for none.
        motion_json: The rig's motion during the sample in a timed drive, as JSON
            (`oaisys_core.trajectory.RigMotion`); empty if nothing that was measured depends on it.
    """

    seed: int
    batch_seed: int
    config_sha256: str
    backend: str
    backend_version: str
    quality: str
    render_samples: int
    device: str = "cpu"
    stage_seed: int = 0
    asset_seed: int = 0
    metadata_json: str = ""
    previous_poses_json: str = ""
    exposures_json: str = ""
    motion_json: str = ""


@dataclass(frozen=True, repr=False)
class Frame(ShortRepr):
    """One image of one sensor.

    Attributes:
        sensor: Name of the sensor.
        modality: See `modality_spec`.
        data: (H, W) or (H, W, channels) by `modality_spec`. Depth is planar z in metres at the
            pixel's centre (of a fisheye, the range), ``+inf`` where nothing was hit (REP-117).
        intrinsics: The camera.
        T_map_camera: (4, 4) pose of the camera's *optical* frame (z forward, x right, y down).
    """

    sensor: str
    modality: str
    data: NDArray[Any]
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray


_POINT = (("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"))
_POINT_TIME = ("time", "<f4")
_EXTRA_POINT_FIELDS = {"label": "<u2", "instance": "<u4"}


def point_dtype(extra_fields: Sequence[str] = ()) -> np.dtype[Any]:
    """Return the dtype, without padding, of a lidar's points.

    * ``x``, ``y``, ``z``: metres, in the lidar's frame at the time of the ray.
    * ``intensity``: 0 to 255.
    * ``ring``: the channel, 0 is the lowest.
    * ``time``: seconds since the beginning of the scan.
    * ``label``, ``instance``: semantic id on level 0, and instance id, if named.
    """
    extra = [(name, _EXTRA_POINT_FIELDS[name]) for name in extra_fields]
    return np.dtype([*_POINT, _POINT_TIME, *extra])


@dataclass(frozen=True, repr=False)
class LidarScan(ShortRepr):
    """The points of one scan of one lidar.

    Attributes:
        sensor: Name of the lidar.
        data: (N,) points in the order of their times, see `point_dtype`. They are not corrected for
            the motion during the scan.
        T_map_lidar: (4, 4) pose of the lidar at the beginning of the scan (x forward, z up).
    """

    sensor: str
    data: NDArray[Any]
    T_map_lidar: FloatArray

    @property
    def modality(self) -> str:
        """`POINTS`."""
        return POINTS

    @property
    def points_m(self) -> FloatArray:
        """(N, 3) points in the lidar's frame."""
        return np.stack([self.data[axis].astype(np.float64) for axis in "xyz"], axis=-1)


def early_first(frames: Iterable[Frame]) -> tuple[Frame, ...]:
    """Return frames in the order in which they are sent: depth and labels before colour."""
    return tuple(sorted(frames, key=lambda frame: frame.modality in COLORS))


@dataclass(frozen=True)
class FrameName:
    """Identifies a frame of a sample."""

    sensor: str
    modality: str


@dataclass(frozen=True)
class Odometry:
    """A drifting rig's estimate of its pose.

    Attributes:
        pose: Estimated pose of the rig in ``map``.
        sigma_m, sigma_rad: Standard deviation of its error along and about each axis.
    """

    pose: Pose
    sigma_m: float
    sigma_rad: float


@dataclass(frozen=True)
class Twist:
    """Velocity of a body, in its own axes, as in ``nav_msgs/Odometry``.

    Attributes:
        velocity_m_s: Linear velocity.
        angular_rate_rad_s: Angular rate.
    """

    velocity_m_s: tuple[float, float, float]
    angular_rate_rad_s: tuple[float, float, float]


@dataclass(frozen=True)
class SampleOutline:
    """A sample without its images, known before they are rendered.

    If the sample is not completed, the next one gets its ids.

    Attributes:
        frames: The frames that it will contain, in order, then the scans.
        provenance: That of the sample, except that ``render_samples`` is 0 and ``exposures_json``
            is empty.
        from_cache, odometry: See `Sample`.
    """

    batch_id: int
    sample_id: int
    rig_pose: Pose
    frames: tuple[FrameName, ...]
    provenance: Provenance
    from_cache: bool = False
    odometry: Odometry | None = None


@dataclass(frozen=True)
class Sample:
    """All frames rendered for one rig pose.

    Attributes:
        batch_id, sample_id: Counted from 1; sample ids restart with each batch.
        rig_pose: Pose of the rig (``base_link``) in ``map``.
        frames: One per camera and modality.
        render_time_s: Wall-clock time of rendering.
        provenance: How to render it again.
        from_cache: Whether the frames were rendered for an earlier sample of the same view.
        finished_ns: Time at which the last frame was rendered, by `time.monotonic_ns` on the
            rendering machine; 0 if it is not known.
        odometry: The rig's estimate of its pose; None without drift in ``sensors.faults``.
        scans: One per lidar.
    """

    batch_id: int
    sample_id: int
    rig_pose: Pose
    frames: tuple[Frame, ...]
    render_time_s: float
    provenance: Provenance
    from_cache: bool = False
    finished_ns: int = field(default=0, compare=False)
    odometry: Odometry | None = None
    scans: tuple[LidarScan, ...] = ()

    @property
    def outline(self) -> SampleOutline:
        """The outline of this sample."""
        return SampleOutline(
            batch_id=self.batch_id,
            sample_id=self.sample_id,
            rig_pose=self.rig_pose,
            frames=(
                *(FrameName(frame.sensor, frame.modality) for frame in self.frames),
                *(FrameName(scan.sensor, scan.modality) for scan in self.scans),
            ),
            provenance=self.provenance,
            from_cache=self.from_cache,
            odometry=self.odometry,
        )

    def frame(self, sensor: str, modality: str) -> Frame:
        """Return the frame of ``sensor`` and ``modality``; `KeyError` where there is none."""
        for candidate in self.frames:
            if candidate.sensor == sensor and candidate.modality == modality:
                return candidate
        raise KeyError(f"no frame {sensor}/{modality}")

    def scan(self, sensor: str) -> LidarScan:
        """Return the scan of a lidar; `KeyError` where there is none."""
        for candidate in self.scans:
            if candidate.sensor == sensor:
                return candidate
        raise KeyError(f"no scan of {sensor}")


ODOMETRY = "odometry"
"""Name under which a drive counts odometry among its sensors."""


@dataclass(frozen=True)
class ImuReading:
    """One measurement of one IMU, in its own frame.

    Attributes:
        sensor: Name of the IMU.
        angular_rate_rad_s: Angular rate about x, y and z.
        specific_force_m_s2: Acceleration minus gravity.
    """

    sensor: str
    angular_rate_rad_s: tuple[float, float, float]
    specific_force_m_s2: tuple[float, float, float]


@dataclass(frozen=True)
class DriveInstant:
    """Everything that a drive brings at one simulated time.

    Attributes:
        time_ns: Simulated time.
        pose: True pose of ``base_link`` in ``map``.
        velocity_m_s, angular_rate_rad_s: True twist in ``base_link``, as in ``nav_msgs/Odometry``.
        has_odometry: Whether odometry is due.
        odometry: What it estimates at this time, due or not; None without drift.
        imus: What the IMUs measure that are due.
        sensors: Names of the cameras and lidars that are due.
        sample: What these saw; None where none is due.
    """

    time_ns: int
    pose: Pose
    velocity_m_s: tuple[float, float, float]
    angular_rate_rad_s: tuple[float, float, float]
    has_odometry: bool = False
    odometry: Odometry | None = None
    imus: tuple[ImuReading, ...] = ()
    sensors: tuple[str, ...] = ()
    sample: Sample | None = None


def _as_rendered(frame: Frame) -> Frame:
    return frame


@dataclass(frozen=True)
class RecordedSample:
    """A sample as it was recorded.

    Attributes:
        outline: The sample without its images.
        frames: The recorded images, which may be fewer than were rendered.
        recorded: Returns a rendered frame as it would have been recorded, with sensor faults.
        scans: The recorded scans.
    """

    outline: SampleOutline
    frames: tuple[Frame, ...]
    recorded: Callable[[Frame], Frame] = _as_rendered
    scans: tuple[LidarScan, ...] = ()


@dataclass(frozen=True, repr=False)
class TriangleMesh(ShortRepr):
    """Triangles in ``map``, with optional ids per triangle.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 vertex indices.
        semantic_ids: (T,) uint16 or None.
        instance_ids: (T,) uint32 or None.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    semantic_ids: NDArray[np.uint16] | None = None
    instance_ids: NDArray[np.uint32] | None = None


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
        name: Name of the group.
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


@dataclass(frozen=True, repr=False)
class TimedPoses(ShortRepr):
    """Poses of ``base_link`` in ``map`` at K times, with a smooth motion between them.

    Attributes:
        times_s: (K,) increasing times.
        positions_m: (K, 3) positions.
        quats_xyzw: (K, 4) orientations.
    """

    times_s: FloatArray
    positions_m: FloatArray
    quats_xyzw: FloatArray


@dataclass(frozen=True)
class PlannedTrajectory:
    """A trajectory that a simulator has planned and keeps for drives.

    Attributes:
        name: Its name in the simulator.
        poses: The poses that its motion interpolates; simulated time starts at the first one.
        end_s: Time at which a drive ends.
        length_m: Length of the way until then.
        gravity_m_s2: Gravity that IMUs measure.
        odometry_rate_hz: Rate of odometry.
        obstacle: What a rover stops in front of, in words; empty for nothing.
        odometry_drift_json: Errors of odometry, with the configuration's keys; empty for none.
    """

    name: str
    poses: TimedPoses
    end_s: float
    length_m: float
    gravity_m_s2: float
    odometry_rate_hz: float
    obstacle: str = ""
    odometry_drift_json: str = ""


@dataclass(frozen=True)
class DriveOutline:
    """A drive before its first measurement.

    Attributes:
        trajectory: Name of the trajectory.
        batch_id: The world.
        start_ns, end_ns: Simulated time at the beginning and at the end.
        due: The number of measurements of each sensor, and of `ODOMETRY`.
    """

    trajectory: str
    batch_id: int
    start_ns: int
    end_ns: int
    due: Mapping[str, int]


@dataclass(frozen=True, repr=False)
class HeightGrid(ShortRepr):
    """Heights at the centres of square cells, in ``map``; NaN where a centre is off the stage.

    Attributes:
        ground_m: (rows, columns) float32 elevation of the ground; row 0 in the south (least y),
            column 0 in the west (least x).
        surface_m: The same of the topmost surface, objects included.
        origin_xy_m: Centre of cell [0, 0].
        spacing_m: Edge of a cell.
    """

    ground_m: NDArray[np.float32]
    surface_m: NDArray[np.float32]
    origin_xy_m: tuple[float, float]
    spacing_m: float


@dataclass(frozen=True, repr=False)
class HeightQuery(ShortRepr):
    """Heights under points; NaN where there is no ground: off a stage that no land surrounds.

    Attributes:
        ground_height_m: (N,) elevation of the ground.
        surface_height_m: (N,) height of the topmost surface, objects included.
        clearance_m: (N,) the point's z minus the surface's height; negative inside the ground.
    """

    ground_height_m: FloatArray
    surface_height_m: FloatArray
    clearance_m: FloatArray


MAX_OBJECTS = 5000
"""Largest number of objects in an `ObjectPage`, which then fits gRPC's default message size."""


@dataclass(frozen=True)
class ObjectQuery:
    """Selects objects of a world that meet all the conditions; an empty one admits all.

    Attributes:
        kinds: ``rock``, ``solid``, ``group``, ``object``, ``mover``, ``added``.
        groups: Kinds of rock, names of groups, shapes of solids.
        names: Whole names.
        instance_ids: Instance ids.
        low_m, high_m: Corners of a box in ``map`` that contains the object's position.
        after_instance_id: Largest id of the previous page; only larger ids are returned.
        limit: Largest number of objects to return.
    """

    kinds: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    instance_ids: tuple[int, ...] = ()
    low_m: tuple[float, float, float] | None = None
    high_m: tuple[float, float, float] | None = None
    after_instance_id: int = 0
    limit: int = 1000


@dataclass(frozen=True)
class SceneObject:
    """A visible object of a world.

    Attributes:
        name: Its unique name: its own, or its group or kind with the instance id.
        kind: See `ObjectQuery`.
        group: Kind of rock, name of the group or shape of a solid; else empty.
        label, semantic_id: Label on level 0.
        pose: Pose in ``map`` of the centre of its base, or of a solid's centre.
        scale: Factor on the size of its shape.
        low_m, high_m: Corners of its axis-aligned bounding box in ``map``.
    """

    instance_id: int
    name: str
    kind: str
    group: str
    label: str
    semantic_id: int
    pose: Pose
    scale: float
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]


@dataclass(frozen=True)
class ObjectPage:
    """Objects of a world in the order of their instance ids.

    Attributes:
        total: Number of objects that the query selects, on all pages.
        next_after_instance_id: ``after_instance_id`` of the next page; 0 if there is none.
    """

    objects: tuple[SceneObject, ...]
    total: int
    next_after_instance_id: int


OWN_PARTS = frozenset({"sensor", "environment", "asset", "render"})
"""Parts of `ModuleMetadata` that are fields of their own; all others are in ``custom``."""


@dataclass(frozen=True)
class ModuleMetadata:
    """What a caller changes with a step, by module; an absent part changes nothing.

    Each part is a mapping of the module's own keys; a module refuses keys that it does not know.
    The pose of the rig is ``sensor["pose"]`` (`Pose`).
    """

    sensor: Mapping[str, Any] | None = None
    environment: Mapping[str, Any] | None = None
    asset: Mapping[str, Any] | None = None
    render: Mapping[str, Any] | None = None
    custom: Mapping[str, Any] = field(default_factory=dict)

    def part(self, name: str) -> Mapping[str, Any] | None:
        """Return a part by its name, a field or a key of ``custom``; None if it is absent."""
        part: Mapping[str, Any] | None
        part = getattr(self, name) if name in OWN_PARTS else self.custom.get(name)
        return part

    def updated(self, later: ModuleMetadata) -> ModuleMetadata:
        """Return this metadata with ``later`` applied.

        Nested mappings are merged key by key; any other value replaces the earlier one.
        """
        return ModuleMetadata(
            sensor=merged(self.sensor, later.sensor),
            environment=merged(self.environment, later.environment),
            asset=merged(self.asset, later.asset),
            render=merged(self.render, later.render),
            custom=merged(self.custom, later.custom),
        )


def merged(earlier: Mapping[str, Any] | None, later: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return two mappings merged at any depth; values of ``later`` replace earlier ones."""
    result = dict(earlier or {})
    for key, value in (later or {}).items():
        both = isinstance(value, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merged(result[key], value) if both else value
    return result


@dataclass(frozen=True)
class Progress:
    """The progress of an operation.

    Attributes:
        stage: What it is doing, such as ``terrain`` or ``render``.
        fraction: Completed share of the whole operation, 0 to 1.
        seconds_left: Estimated time to its end; None if it is not known.
    """

    stage: str
    fraction: float
    seconds_left: float | None = None


def ignore_progress(progress: Progress) -> None:
    """Do nothing."""
