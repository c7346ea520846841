"""The rig: where its cameras are when a sample is taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core import geometry
from oaisys_core.config.sensors import CameraConfig, SensorsConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.module import Metadata, Module, World
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import (
    FloatArray,
    HeightQuery,
    Pose,
    SensorInfo,
)

START_HEIGHT_M = 10.0
"""Height above the ground's centre of the rig that was never given a pose; it looks down."""

Extent = tuple[float, float, float, float]

HeightLookup = Callable[[FloatArray], HeightQuery]
"""Heights under (N, 3) points in ``map``."""


class SensorsModule(Module):
    """Holds the cameras and the rig's pose; metadata understands ``pose`` (`Pose`)."""

    name = "sensors"
    metadata_part = "sensor"

    def __init__(self, config: SensorsConfig) -> None:
        self._config = config
        self.sensors = tuple(_sensor_info(camera) for camera in config.all_cameras)
        self.rig_pose: Pose | None = None

    def check(self, metadata: Metadata) -> None:
        """Refuse unknown keys and poses that are none."""
        for key, value in (metadata or {}).items():
            path = f"metadata.{self.metadata_part}.{key}"
            if key != "pose":
                raise InvalidInputError(path, value, "the key pose")
            if not isinstance(value, Pose):
                raise InvalidInputError(path, value, "a Pose")
            geometry.checked_pose(value.position_m, value.quat_xyzw, path)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Begin a batch above the ground's centre, or where the metadata says."""
        self.rig_pose = None
        self.step_sample(world, metadata, rng)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Move the rig."""
        pose = (metadata or {}).get("pose")
        if pose is not None:
            self.rig_pose = geometry.checked_pose(pose.position_m, pose.quat_xyzw)
        elif self.rig_pose is None and world.ground is not None:
            x0, y0, x1, y1 = world.ground.extent_m
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            z = float(world.ground.height_at([(x, y)])[0]) + START_HEIGHT_M
            self.rig_pose = geometry.pose_looking_down(x, y, z)
        if self.rig_pose is not None:
            world.cameras = tuple(placed(sensor, self.rig_pose) for sensor in self.sensors)

    def admit(self, pose: Pose, heights: HeightLookup, extent_m: Extent) -> Pose:
        """Return the pose that the policy makes of ``pose``.

        Args:
            extent_m: (min_x, min_y, max_x, max_y) of the stage.

        Raises:
            InvalidInputError: Under the policy ``reject``: a camera would be off the stage or
                nearer to the surface than the least clearance.
        """
        policy = self._config.pose_policy
        if policy == "allow":
            return pose
        if policy == "clamp":
            pose = _moved(pose, _way_inside_m(self._camera_positions_m(pose), extent_m))
        least_m = self._config.min_clearance_m
        clearance_m = heights(self._camera_positions_m(pose)).clearance_m
        if (clearance_m >= least_m).all():
            return pose
        if policy == "clamp" and np.isfinite(clearance_m).all():
            return _moved(pose, (0.0, 0.0, float(least_m - clearance_m.min())))
        worst = int(np.argmin(np.nan_to_num(clearance_m, nan=-np.inf)))
        raise _refusal(self.sensors[worst].name, pose, float(clearance_m[worst]), least_m)

    def _camera_positions_m(self, pose: Pose) -> FloatArray:
        return np.array([placed(sensor, pose).T_map_camera[:3, 3] for sensor in self.sensors])


def placed(sensor: SensorInfo, rig_pose: Pose) -> PlacedCamera:
    """Return a sensor where the rig's pose puts it."""
    T_map_camera = geometry.pose_to_matrix(rig_pose) @ sensor.T_base_camera
    return PlacedCamera(sensor.name, sensor.intrinsics, T_map_camera, sensor.modalities)


def select(
    cameras: Sequence[PlacedCamera], modalities: Sequence[str], sensors: Sequence[str]
) -> tuple[PlacedCamera, ...]:
    """Return the cameras and modalities named, in the cameras' order; none named: all.

    Raises:
        InvalidInputError: There is no such sensor or modality.
    """
    names = [camera.name for camera in cameras]
    for sensor in sensors:
        if sensor not in names:
            raise InvalidInputError("sensors", sensor, f"one of {', '.join(names)}")
    offered = {modality for camera in cameras for modality in camera.modalities}
    for modality in modalities:
        if modality not in offered:
            known = ", ".join(sorted(offered))
            raise InvalidInputError("modalities", modality, f"one of {known}")
    return tuple(
        replace(c, modalities=tuple(m for m in c.modalities if not modalities or m in modalities))
        for c in cameras
        if not sensors or c.name in sensors
    )


def _moved(pose: Pose, offset_m: ArrayLike) -> Pose:
    x, y, z = np.asarray(pose.position_m) + np.asarray(offset_m)
    return Pose((float(x), float(y), float(z)), pose.quat_xyzw)


def _way_inside_m(positions_m: FloatArray, extent_m: Extent) -> FloatArray:
    """Return the (3,) shift that brings points, which lie close together, onto the stage."""
    low, high = np.array(extent_m[:2]), np.array(extent_m[2:])
    too_low = np.maximum(low - positions_m[:, :2], 0).max(axis=0)
    too_high = np.maximum(positions_m[:, :2] - high, 0).max(axis=0)
    return np.append(too_low - too_high, 0.0)


def _refusal(sensor: str, pose: Pose, clearance_m: float, least_m: float) -> InvalidInputError:
    if np.isnan(clearance_m):
        where = f"sensor {sensor!r} would be off the stage"
    elif clearance_m < 0:
        where = f"sensor {sensor!r} would be {-clearance_m:.3f} m under the surface"
    else:
        where = f"sensor {sensor!r} would be only {clearance_m:.3f} m above the surface"
    return InvalidInputError(
        "pose.position",
        list(pose.position_m),
        f"a clearance of at least {least_m:g} m over the stage ({where})",
    )


def _sensor_info(camera: CameraConfig) -> SensorInfo:
    mount = geometry.checked_pose(
        camera.mount_position_m, camera.mount_quat_xyzw, f"sensors.cameras.{camera.name}.mount"
    )
    T_base_camera = geometry.pose_to_matrix(mount) @ geometry.T_LINK_OPTICAL
    return SensorInfo(camera.name, camera.intrinsics, T_base_camera, tuple(camera.modalities))
