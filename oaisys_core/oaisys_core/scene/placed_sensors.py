"""Cameras and lidars at the time of a sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.image_sensor import ImageSensor
from oaisys_core.types import (
    FLOW,
    POINTS,
    RGB,
    FloatArray,
    PinholeIntrinsics,
    ShortRepr,
)


@dataclass(frozen=True)
class Lens:
    """A thin lens, for depth of field in colour only.

    Attributes:
        focus_distance_m: Planar distance that is in focus.
        f_number: Focal length divided by the diameter of the aperture.
        blades: Number of aperture blades; below 3 the aperture is round.
        blade_rotation_rad: Rotation of the blades.
        ratio: Width divided by height of the blur; 1 for a spherical lens.
    """

    focus_distance_m: float
    f_number: float
    blades: int = 0
    blade_rotation_rad: float = 0.0
    ratio: float = 1.0


STILL = 1e-9
"""Largest difference of the elements of two poses, in metres or of unit vectors, at rest."""


@dataclass(frozen=True, repr=False)
class PlacedCamera(ShortRepr):
    """A camera at the time of a sample.

    Attributes:
        T_map_camera: (4, 4) pose of the optical frame.
        modalities: What to render.
        T_map_previous: (4, 4) pose at this camera's previous sample of the batch, for optical flow
            and motion blur; None at the first.
        lens: Lens for depth of field; None if everything is in focus.
        shutter_share: Share of the motion since the previous pose during which the shutter is
            open; 0 for no motion blur.
        stereo_baseline_m: Distance of the two cameras of a stereo pair, for disparities; 0 for a
            single camera.
        readout_s: Time from the first row's exposure to the last row's; 0 for a global shutter.
        exposure_s: Time for which each row is exposed, which blurs colour.
        image_sensor: Makes digital numbers of light.
        pose_at: Poses during readout and exposure, from the middle of the first row's exposure on;
            None: the camera stands still.
    """

    name: str
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    modalities: tuple[str, ...]
    T_map_previous: FloatArray | None = None
    lens: Lens | None = None
    shutter_share: float = 0.0
    stereo_baseline_m: float = 0.0
    readout_s: float = 0.0
    exposure_s: float = 0.0
    image_sensor: ImageSensor | None = None
    pose_at: PoseAtTime | None = None

    @property
    def is_sharp(self) -> bool:
        """Whether there is neither depth of field nor motion blur, of which a still has none."""
        return self.lens is None and self.is_still

    @property
    def is_still(self) -> bool:
        """Whether the camera does not move while its shutter is open."""
        if self.exposure_s and self.pose_at is not None:
            open_s = np.array((-0.5, 0.5)) * self.exposure_s + (0.0, self.readout_s)
            T_begin, T_end = self.pose_at(open_s)
            return np.allclose(T_begin, T_end, rtol=0, atol=STILL)
        if self.shutter_share and self.T_map_previous is not None:
            return np.allclose(self.T_map_previous, self.T_map_camera, rtol=0, atol=STILL)
        return True

    @property
    def depends_on_past(self) -> bool:
        """Whether the images depend on the camera's pose at the previous sample."""
        is_blurred = (self.shutter_share or self.exposure_s) and RGB in self.modalities
        return FLOW in self.modalities or bool(is_blurred or self.readout_s)

    def row_poses(self) -> FloatArray | None:
        """Return the (H, 4, 4) pose in the middle of each row's exposure; None if all are one."""
        if self.pose_at is None or self.readout_s == 0:
            return None
        return self.pose_at(np.linspace(0.0, self.readout_s, self.intrinsics.height_px))


@dataclass(frozen=True, repr=False)
class ScanPattern(ShortRepr):
    """The rays of a lidar's scan, in the order of their times.

    Attributes:
        directions: (N, 3) unit vectors in the lidar's frame (x forward, y left, z up).
        times_s: (N,) since the beginning of the scan.
        rings: (N,) uint16 channels.
    """

    directions: FloatArray
    times_s: FloatArray
    rings: NDArray[np.uint16]


PoseAtTime = Callable[[FloatArray], FloatArray]
"""Returns the (T, 4, 4) poses ``T_map_sensor`` at (T,) times in seconds since the sample's own."""


@dataclass(frozen=True)
class LidarErrors:
    """Errors of a lidar's measurements; by default none.

    Attributes:
        seed: Root seed of the errors.
        range_sigma_m: Standard deviation of the range.
        drop_from_rad: Angle of incidence from which rays are lost, see `LidarFaultsConfig`.
    """

    seed: int = 0
    range_sigma_m: float = 0.0
    drop_from_rad: float | None = None


@dataclass(frozen=True, repr=False)
class PlacedLidar(ShortRepr):
    """A lidar at the time of a sample; see `LidarConfig` for what it measures.

    Attributes:
        pattern: The rays of this scan.
        T_map_lidar: (4, 4) pose at the beginning of the scan.
        pose_at: Poses during the scan; None: it stands still.
        beam_divergence_rad: Full angle of the beam.
        modalities: `POINTS`, or nothing if it does not scan.
        depends_on_past: Whether the scan depends on the lidar's pose at the previous sample.
    """

    name: str
    pattern: ScanPattern
    T_map_lidar: FloatArray
    min_range_m: float
    max_range_m: float
    reference_range_m: float
    pose_at: PoseAtTime | None = None
    beam_divergence_rad: float = 0.0
    return_separation_m: float = 0.5
    extra_fields: tuple[str, ...] = ()
    errors: LidarErrors = LidarErrors()
    modalities: tuple[str, ...] = (POINTS,)
    depends_on_past: bool = False
