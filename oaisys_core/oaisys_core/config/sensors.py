"""The rig and its cameras."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from oaisys_core.config.section import Positive, Section, Vector3

MAX_IMAGE_SIDE_PX = 16384
MAX_IMAGE_PX = 100_000_000

FrameName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Modality = Annotated[
    str, Field(pattern="^(rgb|depth|range|semantic_[0-9]|instance|normal|flow|albedo)$")
]


class CameraConfig(Section):
    """A pinhole camera on the rig.

    Attributes:
        cx_px, cy_px: Principal point, pixel centres at integers; None: the image's centre.
        mount_position_m, mount_quat_xyzw: Pose of the camera's link (x forward) in ``base_link``.
    """

    name: FrameName = "camera"
    width_px: int = Field(default=640, ge=1, le=MAX_IMAGE_SIDE_PX)
    height_px: int = Field(default=480, ge=1, le=MAX_IMAGE_SIDE_PX)
    fx_px: Positive = 541.14
    fy_px: Positive = 541.14
    cx_px: float | None = None
    cy_px: float | None = None
    mount_position_m: Vector3 = (0.0, 0.0, 0.0)
    mount_quat_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    modalities: tuple[Modality, ...] = Field(
        default=("rgb", "depth", "semantic_0", "instance"), min_length=1
    )

    @model_validator(mode="after")
    def _bounded(self) -> CameraConfig:
        if self.width_px * self.height_px > MAX_IMAGE_PX:
            raise ValueError(f"an image has at most {MAX_IMAGE_PX} pixels")
        if abs(sum(v * v for v in self.mount_quat_xyzw) ** 0.5 - 1) > 1e-3:
            raise ValueError("mount_quat_xyzw must be a unit quaternion")
        return self


class SensorsConfig(Section):
    """The rig.

    Attributes:
        pose_policy: What happens to a pose under the ground or off the stage: ``reject``,
            ``clamp`` (to the least clearance, inside the stage) or ``allow``.
        min_clearance_m: Least height of every camera above the topmost surface.
    """

    cameras: tuple[CameraConfig, ...] = Field(default=(CameraConfig(),), min_length=1)
    pose_policy: Literal["reject", "clamp", "allow"] = "reject"
    min_clearance_m: float = Field(default=0.05, ge=0)

    @field_validator("cameras")
    @classmethod
    def _unique_names(cls, value: tuple[CameraConfig, ...]) -> tuple[CameraConfig, ...]:
        names = [camera.name for camera in value]
        if len(set(names)) != len(names):
            raise ValueError("camera names must differ")
        return value
