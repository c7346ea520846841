"""Everything that is rendered for one pose of the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import sample_pictures
from oaisys_core.types.arrays import FloatArray, ShortRepr
from oaisys_core.types.cameras import PinholeIntrinsics
from oaisys_core.types.modalities import RENDERED
from oaisys_core.types.poses import Odometry, Pose
from oaisys_core.types.scans import LidarScan


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


def early_first(frames: Iterable[Frame]) -> tuple[Frame, ...]:
    """Return frames in the order in which they are sent: depth and labels before colour."""
    return tuple(sorted(frames, key=lambda frame: frame.modality in RENDERED))


@dataclass(frozen=True)
class FrameName:
    """Identifies a frame of a sample."""

    sensor: str
    modality: str


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

    def _repr_html_(self) -> str:
        """Return the sample's pictures, which notebooks show."""
        return sample_pictures.html(f"batch {self.batch_id} sample {self.sample_id}", self.frames)

    def show(self) -> None:
        """Open all images side by side in the desktop's viewer.

        Raises:
            ValueError: The sample has no image.
            ImportError: pillow is not installed.
        """
        sample_pictures.image_of(sample_pictures.sheet(self.frames)).show()

    def save(self, path: Path | str) -> Path:
        """Write the sample to one file, whose suffix says what it holds.

        Args:
            path: With ``.npz``, all arrays as they are, named ``sensor/modality``, of cameras also
                ``sensor/K`` (3, 3) and ``sensor/T_map_camera`` (4, 4). With ``.png``, ``.jpg`` or
                ``.webp``, one picture of all images side by side. Its folder is made.

        Returns:
            The path.

        Raises:
            InvalidInputError: The suffix is another.
            ValueError: A picture is asked for, and the sample has no image.
        """
        file = Path(path)
        if file.suffix.lower() not in (".npz", ".png", ".jpg", ".webp"):
            expected = "a file that ends in .npz, .png, .jpg or .webp"
            raise InvalidInputError("path", str(path), expected)
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix.lower() == ".npz":
            np.savez_compressed(file, **self._arrays())
        else:
            sample_pictures.image_of(sample_pictures.sheet(self.frames)).save(file)
        return file

    def _arrays(self) -> dict[str, Any]:
        """Return all arrays by the names that they have in a file."""
        arrays: dict[str, Any] = {}
        for frame in self.frames:
            arrays[f"{frame.sensor}/{frame.modality}"] = frame.data
            arrays[f"{frame.sensor}/K"] = frame.intrinsics.K
            arrays[f"{frame.sensor}/T_map_camera"] = frame.T_map_camera
        return arrays | {f"{scan.sensor}/{scan.modality}": scan.data for scan in self.scans}


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
