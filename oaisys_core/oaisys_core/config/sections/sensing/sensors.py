"""Configuration of the rig, its sensors and its motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from oaisys_core.config.section import Position, Quaternion, Section
from oaisys_core.config.sections.sensing.cameras import CameraConfig, StereoConfig
from oaisys_core.config.sections.sensing.faults import FaultsConfig
from oaisys_core.config.sections.sensing.imu import ImuConfig
from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.config.sections.sensing.motion import AnyMotion, GivenMotion
from oaisys_core.errors import one_of
from oaisys_core.types import (
    DISPARITY,
    POINTS,
)

PosePolicy = Literal["reject", "clamp", "allow"]
"""How to handle a pose below the ground or outside the stage."""


class StartPoseConfig(Section):
    """Where the rig is before anything moves it.

    Attributes:
        position_m, quat_xyzw: Pose in ``map``; by default it looks along x.
    """

    position_m: Position
    quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)


class SensorsConfig(Section):
    """The rig and its sensors.

    Attributes:
        cameras: Single cameras; by default one, or none if stereo pairs are given.
        stereo: Stereo pairs.
        lidars: Lidars.
        imus: Inertial measurement units, which measure during timed drives.
        motion: Motion of the rig if no pose is given.
        start_pose: Pose of the rig before the first sample; None: 10 m above the stage's centre,
            or above the water there, looking down.
        pose_policy: How to handle a pose below the ground or outside the stage: ``reject`` it,
            ``clamp`` it to the least clearance inside the stage, or ``allow`` it.
        min_clearance_m: Least height of every camera above the topmost surface.
        faults: Faults of the sensors; none by default.
    """

    cameras: tuple[CameraConfig, ...] = (CameraConfig(),)
    stereo: tuple[StereoConfig, ...] = ()
    lidars: tuple[LidarConfig, ...] = ()
    imus: tuple[ImuConfig, ...] = ()
    motion: AnyMotion = GivenMotion()
    start_pose: StartPoseConfig | None = None
    pose_policy: PosePolicy = "reject"
    min_clearance_m: float = Field(default=0.05, ge=0)
    faults: FaultsConfig = FaultsConfig()

    @property
    def all_cameras(self) -> tuple[CameraConfig, ...]:
        """The cameras, then the left and right ones of each pair."""
        return (*self.cameras, *(camera for pair in self.stereo for camera in pair.cameras()))

    @property
    def modalities(self) -> frozenset[str]:
        """The modalities of all cameras, and that of lidars if there are any."""
        of_cameras = {modality for camera in self.all_cameras for modality in camera.modalities}
        return frozenset(of_cameras | ({POINTS} if self.lidars else set()))

    @model_validator(mode="before")
    @classmethod
    def _stereo_alone(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("stereo") and "cameras" not in data:
            return {**data, "cameras": ()}
        return data

    @field_validator("cameras")
    @classmethod
    def _unique_names(cls, value: tuple[CameraConfig, ...]) -> tuple[CameraConfig, ...]:
        names = [camera.name for camera in value]
        if len(set(names)) != len(names):
            raise ValueError("expected camera names that differ")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> SensorsConfig:
        names = [camera.name for camera in self.all_cameras]
        if not names:
            raise ValueError("there must be a camera or a stereo pair")
        for camera in self.cameras:
            if DISPARITY in camera.modalities:
                raise ValueError(f"{camera.name} renders disparity, which needs a pair in stereo")
        if len(set(names)) != len(names):
            raise ValueError("cameras and the cameras of stereo pairs must have different names")
        everything = [*names, *(lidar.name for lidar in self.lidars)]
        everything += [imu.name for imu in self.imus]
        if len(set(everything)) != len(everything):
            raise ValueError("sensors must have different names")
        if self.motion.kind == "grid" and self.motion.camera not in (None, *names):
            known = one_of(names, self.motion.camera)
            raise ValueError(f"motion.camera must be {known}")
        return self
