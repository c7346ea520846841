"""The module that moves the rig and selects the cameras that render a sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from oaisys_core import geometry, randomness
from oaisys_core.config.expectations import refusal
from oaisys_core.config.sections.faults import FaultsConfig
from oaisys_core.config.sections.motion import AnyMotion
from oaisys_core.config.sections.sensors import CameraConfig, PosePolicy, SensorsConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.module import Metadata, Module, World, require
from oaisys_core.modules.camera_selection import cameras_of, due_cameras
from oaisys_core.modules.clearance import Extent, HeightLookup, admitted_pose
from oaisys_core.modules.optics import changed_cameras, lens_of, sensor_info
from oaisys_core.modules.overrides import differing, overridden
from oaisys_core.motion import Motion, MotionStep, make_motion
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray, FrameName, Pose, SensorInfo

START_HEIGHT_M = 10.0
"""Height above the stage's centre at which the rig starts, looking down."""

MOST_DRAWS = 64
"""Number of poses that a motion may draw for one sample."""

MOTION_STREAM = "sensors.motion"
"""Name of the random stream of motions."""


class SensorsModule(Module):
    """Holds the cameras, the rig's pose and its motion.

    Keys of its metadata: ``pose`` (`Pose`), used instead of any motion; ``cameras``, a mapping of
    camera names to optics that change until the next batch; ``faults``, sensor faults that change
    until then, such as ``enabled: false``; for a sample, ``pose_policy``, used instead of the
    configured one; for a batch, ``motion``, used instead of the configured one.
    """

    name = "sensors"
    metadata_part = "sensor"

    def __init__(self, config: SensorsConfig) -> None:
        self._config = config
        self._baselines_m = {f"{pair.name}_right": pair.baseline_m for pair in config.stereo}
        self._cameras = self._changed(config.all_cameras, None)
        self.sensors = self._described(self._cameras)
        self._motion = make_motion(config.motion, self.sensors)
        self.rig_pose: Pose | None = None
        self.faults = config.faults

    @property
    def moves_itself(self) -> bool:
        """Whether a motion moves the rig if a sample's metadata gives no pose."""
        return self._motion is not None

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys and invalid values."""
        self._chosen_motion(metadata)
        self._check(metadata, ("pose", "cameras", "motion", "faults"))
        self._changed(self._config.all_cameras, metadata)
        self._changed_faults(self._config.faults, metadata)

    def check_sample(self, metadata: Metadata) -> None:
        """Raise as `check` does; ``motion`` is only allowed for a batch."""
        self._check(metadata, ("pose", "pose_policy", "cameras", "faults"))
        self._changed(self._cameras, metadata)
        self._changed_faults(self.faults, metadata)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the metadata with all changes of optics and faults, without the pose."""
        configured = self._config.all_cameras
        cameras = {
            now.name: differing(before, now)
            for before, now in zip(configured, self._cameras, strict=True)
            if now != before
        }
        found = {"cameras": cameras, "faults": differing(self._config.faults, self.faults)}
        transient = ("pose", "pose_policy", *found)
        kept = {key: value for key, value in (metadata or {}).items() if key not in transient}
        return kept | {key: value for key, value in found.items() if value}

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Start a batch with the rig above the stage's centre, or at the pose in the metadata."""
        self.rig_pose = None
        self._use(self._config.all_cameras)
        self.faults = self._config.faults
        self._motion = self._chosen_motion(metadata)
        self.step_sample(world, metadata, rng)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Move the rig to the pose in the metadata, and change its cameras."""
        self._use(self._changed(self._cameras, metadata))
        self.faults = self._changed_faults(self.faults, metadata)
        pose = (metadata or {}).get("pose")
        if pose is not None:
            self.rig_pose = geometry.checked_pose(pose.position_m, pose.quat_xyzw)
        elif self.rig_pose is None and world.ground is not None:
            x0, y0, x1, y1 = world.ground.extent_m
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            z = float(world.ground.height_at([(x, y)])[0]) + START_HEIGHT_M
            self.rig_pose = geometry.pose_looking_down(x, y, z)
        self._place(world)

    def move(self, world: World, batch_seed: int, heights: HeightLookup) -> None:
        """Move the rig to the pose of its motion at the world's sample.

        If the policy refuses a pose, the motion draws another one, up to `MOST_DRAWS` times, or the
        pose is lifted, depending on the motion.

        Raises:
            InvalidInputError: The policy refused all poses, or the motion has ended.
        """
        motion, ground = require(self._motion), require(world.ground)
        index = (world.sample_id - 1) // motion.step_interval
        step = MotionStep(
            index=index,
            rng=randomness.stream(batch_seed, MOTION_STREAM, index + 1),
            batch_rng=randomness.stream(batch_seed, MOTION_STREAM),
            ground=ground,
            locate=lambda instance_id: _position_m(world, instance_id),
        )
        self.rig_pose = self._found(motion, step, heights, ground.extent_m)
        self._place(world)

    def admit(
        self, pose: Pose, heights: HeightLookup, extent_m: Extent, policy: PosePolicy | None = None
    ) -> Pose:
        """Return a pose after a policy, by default the configured one, was applied to it."""
        return self._admitted(pose, heights, extent_m, policy or self._config.pose_policy)

    def due(
        self,
        world: World,
        last_rig_poses: Mapping[str, Pose],
        modalities: Sequence[str],
        sensors: Sequence[str],
    ) -> tuple[PlacedCamera, ...]:
        """Return the cameras that render the world's sample; see `due_cameras`."""
        cameras = due_cameras(world, self._cameras, modalities, sensors)
        return self._with_previous_poses(cameras, last_rig_poses)

    def named(
        self, world: World, last_rig_poses: Mapping[str, Pose], frames: Sequence[FrameName]
    ) -> tuple[PlacedCamera, ...]:
        """Return the cameras that render exactly these frames; see `cameras_of`."""
        return self._with_previous_poses(cameras_of(world.cameras, frames), last_rig_poses)

    def _with_previous_poses(
        self, cameras: Sequence[PlacedCamera], last_rig_poses: Mapping[str, Pose]
    ) -> tuple[PlacedCamera, ...]:
        mounts = {sensor.name: sensor.T_base_camera for sensor in self.sensors}
        return tuple(
            replace(c, T_map_previous=_previous(mounts[c.name], last_rig_poses.get(c.name)))
            for c in cameras
        )

    def _found(
        self, motion: Motion, step: MotionStep, heights: HeightLookup, extent_m: Extent
    ) -> Pose:
        policy: str = self._config.pose_policy
        if motion.is_lifted and policy == "reject":
            policy = "lift"
        reason = "the motion leaves the stage"
        draws = MOST_DRAWS if motion.can_redraw else 1
        for _ in range(draws):
            pose = motion.pose(step)
            if pose is None:
                continue
            try:
                return self._admitted(pose, heights, extent_m, policy)
            except InvalidInputError as error:
                reason = f"pose.position {error.received} does not have {error.expected}"
        tries = f"{draws} draws" if draws > 1 else "its only pose"
        expected = f"a pose that sensors.pose_policy accepts ({tries}; {reason})"
        raise InvalidInputError("sensors.motion", f"step {step.index + 1}", expected)

    def _admitted(self, pose: Pose, heights: HeightLookup, extent_m: Extent, policy: str) -> Pose:
        least_m = self._config.min_clearance_m
        return admitted_pose(pose, self.sensors, heights, extent_m, policy=policy, least_m=least_m)

    def _place(self, world: World) -> None:
        if self.rig_pose is None:
            return
        T_map_base = geometry.pose_to_matrix(self.rig_pose)
        world.cameras = tuple(
            PlacedCamera(
                name=sensor.name,
                intrinsics=sensor.intrinsics,
                T_map_camera=T_map_base @ sensor.T_base_camera,
                modalities=sensor.modalities,
                lens=lens_of(camera),
                shutter_share=camera.shutter_share,
            )
            for sensor, camera in zip(self.sensors, self._cameras, strict=True)
        )

    def _check(self, metadata: Metadata, known: Sequence[str]) -> None:
        for key, value in (metadata or {}).items():
            path = f"metadata.{self.metadata_part}.{key}"
            if key not in known:
                raise InvalidInputError(path, value, f"one of the keys {', '.join(known)}")
            if key == "pose":
                if not isinstance(value, Pose):
                    raise InvalidInputError(path, value, "a Pose")
                geometry.checked_pose(value.position_m, value.quat_xyzw, path)
            if key == "pose_policy" and value not in get_args(PosePolicy):
                raise InvalidInputError(path, value, f"one of {', '.join(get_args(PosePolicy))}")

    def _chosen_motion(self, metadata: Metadata) -> Motion | None:
        chosen = (metadata or {}).get("motion")
        if chosen is None:
            return make_motion(self._config.motion, self.sensors)
        try:
            config = _MOTIONS.validate_python(chosen)
        except ValidationError as error:
            raise refusal(error, chosen, "metadata.sensor.motion") from error
        return make_motion(config, self.sensors)

    def _changed(
        self, cameras: tuple[CameraConfig, ...], metadata: Metadata
    ) -> tuple[CameraConfig, ...]:
        return changed_cameras(
            cameras, (metadata or {}).get("cameras", {}), f"{self.metadata_part}.cameras"
        )

    def _changed_faults(self, faults: FaultsConfig, metadata: Metadata) -> FaultsConfig:
        changes = (metadata or {}).get("faults", {})
        path = f"{self.metadata_part}.faults"
        if not isinstance(changes, Mapping):
            expected = f"a mapping of {', '.join(sorted(FaultsConfig.model_fields))}"
            raise InvalidInputError(f"metadata.{path}", changes, expected)
        return overridden(faults, changes, path)

    def _use(self, cameras: tuple[CameraConfig, ...]) -> None:
        """Set the cameras; `sensors` stays the same object if nothing changed."""
        if cameras != self._cameras:
            self._cameras, self.sensors = cameras, self._described(cameras)

    def _described(self, cameras: Sequence[CameraConfig]) -> tuple[SensorInfo, ...]:
        return tuple(
            sensor_info(camera, self._baselines_m.get(camera.name, 0.0)) for camera in cameras
        )


_MOTIONS: TypeAdapter[AnyMotion] = TypeAdapter(AnyMotion)


def _previous(T_base_camera: FloatArray, rig_pose: Pose | None) -> FloatArray | None:
    return None if rig_pose is None else geometry.pose_to_matrix(rig_pose) @ T_base_camera


def _position_m(world: World, instance_id: int) -> FloatArray:
    """Return the (3,) position of an object in ``map``."""
    for primitive in world.primitives:
        if primitive.instance_id == instance_id:
            return np.array(primitive.T_map_object[:3, 3])
    for placement in world.placements:
        (found,) = np.nonzero(placement.instance_ids == instance_id)
        if len(found):
            return np.array(placement.T_map_object[found[0], :3, 3])
    raise InvalidInputError(
        "sensors.motion.target_instance", instance_id, "the instance id of an object in this world"
    )
