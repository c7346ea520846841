"""Configuration of cameras and stereo pairs: lens, modalities, calibration and mount."""

from __future__ import annotations

import logging
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from oaisys_core import geometry
from oaisys_core.config.section import LEAST_RATE_HZ, Position, Positive, Quaternion, Section
from oaisys_core.config.sections.sensing.image_sensor import ImageSensorConfig
from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.calibrations import read_calibration
from oaisys_core.files.path_fields import ConfigFile
from oaisys_core.types import (
    DISPARITY,
    EQUIDISTANT,
    FLOW,
    MAX_IMAGE_PX,
    PLUMB_BOB,
    PinholeIntrinsics,
    modality_expectation,
    modality_spec,
)

_LOG = logging.getLogger(__name__)

MAX_IMAGE_SIDE_PX = 16384

MIN_FOCAL, MAX_FOCAL, MAX_CENTRE = 0.01, 1000.0, 100.0
"""Bounds of focal lengths and of the principal point, in image widths."""

Coefficient = Annotated[float, Field(ge=-1000, le=1000)]
"""A distortion coefficient."""

FrameName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)]


def _require_known(modality: str) -> str:
    try:
        modality_spec(modality)
    except KeyError:
        raise ValueError(f"expected {modality_expectation(modality)}") from None
    return modality


Modality = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$"), AfterValidator(_require_known)]


class DistortionConfig(Section):
    """Brown-Conrady distortion, as in OpenCV and ROS's ``plumb_bob``.

    Attributes:
        k1, k2, k3: Radial coefficients.
        p1, p2: Tangential coefficients.
    """

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    p1: Coefficient = 0.0
    p2: Coefficient = 0.0
    k3: Coefficient = 0.0


class FisheyeConfig(Section):
    """A fisheye lens as in OpenCV's ``fisheye`` and ROS's ``equidistant`` (Kannala-Brandt).

    A direction at the angle a off the axis is imaged a * (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)
    focal lengths from the principal point. Without coefficients, the lens is equidistant.

    Attributes:
        k1, k2, k3, k4: Coefficients.
    """

    k1: Coefficient = 0.0
    k2: Coefficient = 0.0
    k3: Coefficient = 0.0
    k4: Coefficient = 0.0


class LensConfig(Section):
    """A lens with an aperture, for depth of field in colour.

    Attributes:
        focus_distance_m: Distance in focus, along the optical axis.
        f_number: Focal length divided by the diameter of the aperture.
        blades: Number of aperture blades; below 3 the aperture is round.
        blade_rotation_deg: Rotation of the blades.
        ratio: Width divided by height of the blur; 1 for a spherical lens, above 1 for an
            anamorphic one.
    """

    focus_distance_m: float = Field(default=10.0, ge=1e-3, le=1e6)
    f_number: float = Field(default=2.8, ge=0.01, le=1e4)
    blades: int = Field(default=0, ge=0, le=16)
    blade_rotation_deg: float = 0.0
    ratio: float = Field(default=1.0, ge=0.1, le=10)


class OpticsConfig(Section):
    """The optics of a camera, which metadata may change.

    Attributes:
        fx_px, fy_px: Focal lengths, from 0.01 to 1,000 image widths; they differ if pixels are not
            square.
        cx_px, cy_px: Principal point, with pixel centres at integers, at most 100 image widths from
            the corner; None for the centre of the image.
        distortion: Distortion of the lens; None for no distortion.
        lens: Lens for depth of field; None if everything is in focus.
        shutter_share: Share of the motion since the camera's previous pose during which the shutter
            is open; 0 for no motion blur.
    """

    fx_px: Positive = 541.14
    fy_px: Positive = 541.14
    cx_px: float | None = None
    cy_px: float | None = None
    distortion: DistortionConfig | None = None
    lens: LensConfig | None = None
    shutter_share: float = Field(default=0.0, ge=0, le=1)


def optics_bounds_px(width_px: int) -> dict[str, tuple[float, float]]:
    """Return the bounds of each field of the camera matrix, for an image width."""
    focal = (MIN_FOCAL * width_px, MAX_FOCAL * width_px)
    centre = (-MAX_CENTRE * width_px, MAX_CENTRE * width_px)
    return {"fx_px": focal, "fy_px": focal, "cx_px": centre, "cy_px": centre}


OVERRIDING = frozenset({"mount_position_m", "mount_quat_xyzw", "rate_hz", "modalities"})
"""Keys of a camera that may stand beside its calibration, and then count."""


class CalibrationConfig(Section):
    """A calibration of another program, see docs/files.md.

    Attributes:
        file: The file.
        camera: Name of the camera in it, such as ``cam0``; None for the only one.
    """

    file: ConfigFile
    camera: str | None = None


class CameraConfig(OpticsConfig):
    """A camera on the rig.

    Attributes:
        calibration: File from which size, intrinsics, distortion and, where it has one, the mount
            are taken; None once they are.
        name: Name of the sensor, its folder and its topics.
        width_px, height_px: Image size.
        fisheye: Lens of a fisheye camera, whose depth images have ranges along the rays; None for
            a pinhole camera. Every pixel has a ray, at most 180 degrees off the axis.
        mount_position_m, mount_quat_xyzw: Pose of the camera's link (x forward) in ``base_link``.
        modalities: Modalities that it renders; ``disparity`` is for stereo pairs.
        step_interval: Samples from one image to the next.
        step_offset: Samples before the first image.
        modality_intervals: For modalities that it renders less often, the number of its images
            from one to the next.
        rate_hz: Images per second of a timed drive.
        readout_s: Time from the first row's exposure to the last row's (rolling shutter); each row
            of depth, labels and colour is seen from the camera's pose at the row's own time. 0:
            all rows at once (global shutter).
        exposure_s: Time for which each row is exposed; colour is blurred by the camera's motion
            meanwhile. 0: no motion blur by time.
        image_sensor: Makes the digital numbers of ``mono16``, ``rgb16`` and ``bayer_*16``.
    """

    calibration: CalibrationConfig | None = None
    name: FrameName = "camera"
    width_px: int = Field(default=640, ge=1, le=MAX_IMAGE_SIDE_PX)
    height_px: int = Field(default=480, ge=1, le=MAX_IMAGE_SIDE_PX)
    fisheye: FisheyeConfig | None = None
    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    modalities: tuple[Modality, ...] = Field(
        default=("rgb", "depth", "semantic_0", "instance"), min_length=1
    )
    step_interval: int = Field(default=1, ge=1)
    step_offset: int = Field(default=0, ge=0)
    modality_intervals: dict[Modality, Annotated[int, Field(ge=1)]] = Field(default_factory=dict)
    rate_hz: float = Field(default=10.0, ge=LEAST_RATE_HZ, le=10_000)
    readout_s: float = Field(default=0.0, ge=0, le=10)
    exposure_s: float = Field(default=0.0, ge=0, le=10)
    image_sensor: ImageSensorConfig = ImageSensorConfig()

    @property
    def intrinsics(self) -> PinholeIntrinsics:
        """The intrinsics of the camera."""
        d, fisheye = self.distortion, self.fisheye
        distortion: tuple[float, ...] = () if d is None else (d.k1, d.k2, d.p1, d.p2, d.k3)
        if fisheye is not None:
            distortion = (fisheye.k1, fisheye.k2, fisheye.k3, fisheye.k4)
        return PinholeIntrinsics(
            width_px=self.width_px,
            height_px=self.height_px,
            fx_px=self.fx_px,
            fy_px=self.fy_px,
            cx_px=(self.width_px - 1) / 2 if self.cx_px is None else self.cx_px,
            cy_px=(self.height_px - 1) / 2 if self.cy_px is None else self.cy_px,
            distortion=distortion,
            distortion_model=PLUMB_BOB if fisheye is None else EQUIDISTANT,
        )

    @model_validator(mode="before")
    @classmethod
    def _take_calibration(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace ``calibration`` by what its file says; `OVERRIDING` beside it count more."""
        if not isinstance(data, dict) or data.get("calibration") is None:
            return data
        chosen = CalibrationConfig.model_validate(data["calibration"], context=info.context)
        given = {key: value for key, value in data.items() if key != "calibration"}
        try:
            calibration = read_calibration(chosen.file)
            found = calibration.camera(chosen.camera).config()
        except InvalidInputError as error:
            raise ValueError(f"{error} in {chosen.file}") from error
        if calibration.unused:
            _LOG.warning("%s: not used: %s", chosen.file, ", ".join(calibration.unused))
        if twice := sorted(found.keys() & given.keys() - OVERRIDING):
            raise ValueError(f"{twice[0]} is given beside the calibration, expected one of both")
        if not {"width_px", "height_px"} <= found.keys() | given.keys():
            raise ValueError("the calibration has no image size, expected width_px and height_px")
        return found | given

    @model_validator(mode="after")
    def _check_bounds(self) -> CameraConfig:
        if self.width_px * self.height_px > MAX_IMAGE_PX:
            raise ValueError(f"an image has at most {MAX_IMAGE_PX} pixels")
        return self

    @model_validator(mode="after")
    def _within_reach(self) -> CameraConfig:
        for name, (least_px, most_px) in optics_bounds_px(self.width_px).items():
            value_px = getattr(self, name)
            if value_px is not None and not least_px <= value_px <= most_px:
                raise ValueError(
                    f"{name} is {value_px:g}, expected {least_px:g} to {most_px:g} for an image "
                    f"{self.width_px} pixels wide"
                )
        return self

    @model_validator(mode="after")
    def _of_its_own(self) -> CameraConfig:
        if len(set(self.modalities)) != len(self.modalities):
            raise ValueError("modalities must differ")
        for modality in self.modality_intervals:
            if modality not in self.modalities:
                raise ValueError(
                    f"modality_intervals names {quote(modality)}, which it does not render"
                )
        return self

    @model_validator(mode="after")
    def _invertible(self) -> CameraConfig:
        if not geometry.is_invertible(self.intrinsics):
            name = "distortion" if self.fisheye is None else "fisheye"
            raise ValueError(
                f"{name} is not invertible: several directions, or none, map to one pixel"
            )
        return self

    @model_validator(mode="after")
    def _of_one_model(self) -> CameraConfig:
        if self.fisheye is None:
            return self
        for name in ("distortion", "lens"):
            if getattr(self, name) is not None:
                raise ValueError(f"{name} must be null with fisheye, which is a lens of its own")
        camera = self.intrinsics
        inside = 0 <= camera.cx_px < camera.width_px and 0 <= camera.cy_px < camera.height_px
        if not inside:
            raise ValueError("cx_px, cy_px must be inside the image of a fisheye")
        return self

    @model_validator(mode="after")
    def _of_one_shutter(self) -> CameraConfig:
        if self.shutter_share and (self.readout_s or self.exposure_s):
            raise ValueError("shutter_share must be 0 with readout_s or exposure_s")
        if self.readout_s and self.distortion is not None:
            raise ValueError("readout_s must be 0 with distortion")
        if self.readout_s and FLOW in self.modalities:
            raise ValueError("readout_s must be 0 with flow, which is between two poses")
        return self

    @model_validator(mode="after")
    def _check_rectification(self) -> CameraConfig:
        if DISPARITY in self.modalities and not self.intrinsics.is_rectilinear:
            raise ValueError("disparity needs a camera without distortion and without fisheye")
        return self


class StereoConfig(CameraConfig):
    """Two equal cameras side by side, named ``<name>_left`` and ``<name>_right``.

    Attributes:
        baseline_m: Distance of the right camera from the left one along the image rows; the mount
            is that of the left camera.
    """

    name: FrameName = "stereo"
    baseline_m: float = Field(default=0.1, gt=0, le=1000)

    def cameras(self) -> tuple[CameraConfig, CameraConfig]:
        """Return the left and the right camera."""
        shared = self.model_dump(exclude={"baseline_m", "name"})
        mount = geometry.check_pose(self.mount_position_m, self.mount_quat_xyzw)
        to_right = geometry.transform(_NO_TURN, (0.0, -self.baseline_m, 0.0))
        right = geometry.pose_from_matrix(geometry.pose_to_matrix(mount) @ to_right)
        return (
            CameraConfig.model_validate({**shared, "name": f"{self.name}_left"}),
            CameraConfig.model_validate(
                {**shared, "name": f"{self.name}_right", "mount_position_m": right.position_m}
            ),
        )


_NO_TURN = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
