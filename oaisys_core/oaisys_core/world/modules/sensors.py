"""The module that holds the sensors, moves the rig and sets the faults of its sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from oaisys_core import geometry
from oaisys_core.config.expectations import refusal
from oaisys_core.config.sections.sensing.cameras import CameraConfig
from oaisys_core.config.sections.sensing.faults import FaultsConfig
from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.config.sections.sensing.motion import AnyMotion
from oaisys_core.config.sections.sensing.sensors import PosePolicy, SensorsConfig
from oaisys_core.errors import InvalidInputError, one_of, one_of_keys
from oaisys_core.raycast.clearance import HeightLookup, admit_pose
from oaisys_core.scene import PlacedCamera, PlacedLidar, PoseAtTime
from oaisys_core.sensing.faults import PoseDrift
from oaisys_core.trajectory.imu import imu_info
from oaisys_core.trajectory.sample_poses import Motion, make_motion
from oaisys_core.types import FrameName, Odometry, Pose, SensorInfo
from oaisys_core.world.module import Metadata, Module, World, differing, override, require
from oaisys_core.world.modules.cameras import (
    Cameras,
    PlacedSensor,
    change_cameras,
    due_sensors,
    following_cameras,
    place_cameras,
    select,
    sensor_info,
    sensors_of,
    with_previous_poses,
)
from oaisys_core.world.modules.lidars import following, lidar_info, place_lidars, with_motion
from oaisys_core.world.modules.motion_steps import motion_step

START_HEIGHT_M = 10.0
"""Height above the stage's centre at which the rig starts, looking down."""


class DueSensors(NamedTuple):
    """The sensors that render a sample."""

    cameras: tuple[PlacedCamera, ...]
    lidars: tuple[PlacedLidar, ...]

    @property
    def all(self) -> tuple[PlacedSensor, ...]:
        """The cameras, then the lidars."""
        return (*self.cameras, *self.lidars)

    @property
    def is_moving(self) -> bool:
        """Whether any of them moves while it measures."""
        return any(sensor.pose_at is not None for sensor in self.all)


class SensorsModule(Module):
    """Holds the sensors, the rig's pose and its motion.

    Keys of its metadata: ``pose`` (`Pose`), used instead of any motion; ``cameras``, a mapping of
    camera names to optics that change until the next batch; ``faults``, sensor faults that change
    until then, such as ``enabled: false``; for a sample, ``pose_policy``, used instead of the
    configured one; for a batch, ``motion``, used instead of the configured one.

    Attributes:
        sensors: The cameras as clients see them.
        lidars: The lidars as clients see them.
        imus: The IMUs as clients see them.
        rig_pose: Current pose of the rig; None before the first batch.
        depth_faults: Faults of depth images; None if there are none.
    """

    name = "sensors"
    metadata_part = "sensor"
    changes_by_itself = False

    def __init__(self, config: SensorsConfig) -> None:
        self._config = config
        self._baselines_m = {
            camera.name: pair.baseline_m for pair in config.stereo for camera in pair.cameras()
        }
        self._rights = frozenset(pair.cameras()[1].name for pair in config.stereo)
        self._configured_cameras = self._cameras = config.all_cameras
        self.sensors = self._describe(self._cameras)
        self.lidars = tuple(lidar_info(lidar) for lidar in config.lidars)
        self.imus = tuple(imu_info(imu) for imu in config.imus)
        self._motion = make_motion(config.motion, self.sensors)
        self.rig_pose: Pose | None = None
        self._drift = PoseDrift()
        self._use_faults(config.faults)

    @property
    def moves_itself(self) -> bool:
        """Whether a motion moves the rig if a sample's metadata gives no pose."""
        return self._motion is not None

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys and invalid values."""
        self._choose_motion(metadata)
        self._check(metadata, ("pose", "cameras", "motion", "faults"))
        self._change_cameras(self._configured_cameras, metadata)
        self._change_faults(self._config.faults, metadata)

    def check_sample(self, metadata: Metadata) -> None:
        """Raise as `check` does; ``motion`` is only allowed for a batch."""
        self._check(metadata, ("pose", "pose_policy", "cameras", "faults"))
        self._change_cameras(self._cameras, metadata)
        self._change_faults(self._faults, metadata)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the metadata with all changes of optics and faults, without the pose."""
        cameras = {
            now.name: differing(before, now)
            for before, now in zip(self._configured_cameras, self._cameras, strict=True)
            if now != before
        }
        found = {"cameras": cameras, "faults": differing(self._config.faults, self._faults)}
        transient = ("pose", "pose_policy", *found)
        kept = {key: value for key, value in (metadata or {}).items() if key not in transient}
        return kept | {key: value for key, value in found.items() if value}

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Start a batch with the rig at its start pose, or at the pose in the metadata."""
        self.rig_pose = None
        self._use_cameras(self._configured_cameras)
        self._use_faults(self._config.faults)
        self._motion = self._choose_motion(metadata)
        self.step_sample(world, metadata, rng)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Move the rig to the pose in the metadata, and change its cameras."""
        given = metadata or {}
        if "cameras" in given:
            self._use_cameras(self._change_cameras(self._cameras, given))
        if "faults" in given:
            self._use_faults(self._change_faults(self._faults, given))
        pose = given.get("pose")
        if pose is not None:
            self.rig_pose = geometry.check_pose(pose.position_m, pose.quat_xyzw)
        elif self.rig_pose is None:
            self.rig_pose = self._start_pose(world)
        self._place(world)

    def move(self, world: World, batch_seed: int, heights: HeightLookup) -> None:
        """Move the rig to the pose of its motion at the world's sample.

        If the policy refuses a pose, the motion draws another one, up to `MAX_DRAWS` times, or the
        pose is lifted, depending on the motion.

        Raises:
            InvalidInputError: The policy refused all poses, or the motion has ended.
        """
        motion, policy = require(self._motion), self._config.pose_policy
        accepts = "lift" if motion.is_lifted and policy == "reject" else policy
        step = motion_step(motion, world, batch_seed)
        self.rig_pose = motion.first_admitted_pose(
            step, lambda pose: self.admit(pose, world, heights, accepts)
        )
        self._place(world)

    def admit(
        self, pose: Pose, world: World, heights: HeightLookup, policy: str | None = None
    ) -> Pose:
        """Return a pose after a policy, by default the configured one, was applied to it.

        Raises:
            InvalidInputError: The policy refuses the pose.
        """
        return admit_pose(
            pose,
            self.sensors,
            heights,
            require(world.ground).extent_m,
            policy=policy or self._config.pose_policy,
            least_m=self._config.min_clearance_m,
        )

    def check_selection(
        self, world: World, modalities: Sequence[str], sensors: Sequence[str]
    ) -> None:
        """Raise if a sample cannot consist of these modalities and sensors; see `select`."""
        select(self._sensors_of_sample(world), modalities, sensors)

    def due(
        self,
        world: World,
        last_rig_poses: Mapping[str, Pose],
        modalities: Sequence[str],
        sensors: Sequence[str],
    ) -> DueSensors:
        """Return the sensors that render the world's sample; see `due_sensors`."""
        configs: list[CameraConfig | LidarConfig] = [*self._cameras, *self._config.lidars]
        placed, settings = self._sensors_of_sample(world), require(world.render)
        due = due_sensors(placed, configs, world.sample_id, modalities, sensors, settings)
        return self._with_past(due, last_rig_poses)

    def following(self, due: DueSensors, T_map_base: PoseAtTime) -> DueSensors:
        """Return sensors that move with the rig while they measure.

        See `following_cameras` and `lidars.following`.
        """
        return DueSensors(
            following_cameras(due.cameras, self.sensors, T_map_base),
            following(due.lidars, self.lidars, T_map_base),
        )

    def sensors_of_frames(
        self, world: World, last_rig_poses: Mapping[str, Pose], frames: Sequence[FrameName]
    ) -> DueSensors:
        """Return the sensors that render exactly these frames; see `sensors_of`."""
        return self._with_past(sensors_of(self._sensors_of_sample(world), frames), last_rig_poses)

    def _start_pose(self, world: World) -> Pose | None:
        """Return where the rig is before anything moves it; None where there is no ground."""
        start = self._config.start_pose
        if start is not None:
            return geometry.check_pose(start.position_m, start.quat_xyzw, "sensors.start_pose")
        ground = world.ground
        if ground is None:
            return None
        x0, y0, x1, y1 = ground.extent_m
        x, y = (x0 + x1) / 2, (y0 + y1) / 2
        surface_m = float(ground.height_at([(x, y)])[0])
        if world.water is not None:
            surface_m = max(surface_m, world.water.level_m)
        return geometry.pose_looking_down(x, y, surface_m + START_HEIGHT_M)

    def _sensors_of_sample(self, world: World) -> list[PlacedSensor]:
        """Return all sensors, where they are at the world's sample."""
        pose, number = require(self.rig_pose), max(world.sample_id - 1, 0)
        enabled = self._faults.enabled
        lidars = place_lidars(self._config.lidars, self.lidars, pose, number, enabled)
        return [*world.cameras, *lidars]

    def _with_past(
        self, placed: Sequence[PlacedSensor], last_rig_poses: Mapping[str, Pose]
    ) -> DueSensors:
        cameras = [each for each in placed if isinstance(each, PlacedCamera)]
        lidars = [each for each in placed if isinstance(each, PlacedLidar)]
        return DueSensors(
            with_previous_poses(cameras, self._cameras, self.sensors, last_rig_poses),
            with_motion(lidars, self._config.lidars, self.lidars, last_rig_poses),
        )

    @property
    def odometry_drifts(self) -> bool:
        """Whether the rig's estimate of its pose drifts with each sample."""
        return any(self._drift_sigmas)

    def fault_batch(self, batch_id: int) -> int:
        """Return the number of the batch from which faults are drawn."""
        return batch_id if self._faults.batch is None else self._faults.batch

    def odometry(self, batch_id: int, sample_id: int) -> Odometry | None:
        """Return the rig's estimate of its pose at a sample; None without drift."""
        sigmas = self._drift_sigmas
        if not any(sigmas):
            return None
        pose, seed = require(self.rig_pose), self._faults.seed
        return self._drift.odometry(pose, sigmas, seed, self.fault_batch(batch_id), sample_id)

    def _place(self, world: World) -> None:
        if self.rig_pose is not None:
            world.T_map_base = geometry.pose_to_matrix(self.rig_pose)
            world.cameras = place_cameras(
                self._cameras, self.sensors, self.rig_pose, self._baselines_m
            )

    def _check(self, metadata: Metadata, known: Sequence[str]) -> None:
        for key, value in (metadata or {}).items():
            path = f"metadata.{self.metadata_part}.{key}"
            if key not in known:
                raise InvalidInputError(path, value, one_of_keys(known, key))
            if key == "pose":
                if not isinstance(value, Pose):
                    raise InvalidInputError(path, value, "a Pose")
                geometry.check_pose(value.position_m, value.quat_xyzw, path)
            if key == "pose_policy" and value not in get_args(PosePolicy):
                raise InvalidInputError(path, value, one_of(get_args(PosePolicy), value))

    def _choose_motion(self, metadata: Metadata) -> Motion | None:
        chosen = (metadata or {}).get("motion")
        if chosen is None:
            return make_motion(self._config.motion, self.sensors)
        try:
            config = _MOTIONS.validate_python(chosen)
        except ValidationError as error:
            raise refusal(error, chosen, AnyMotion, "metadata.sensor.motion") from error
        return make_motion(config, self.sensors)

    def _change_cameras(self, cameras: Cameras, metadata: Metadata) -> Cameras:
        changes = (metadata or {}).get("cameras", {})
        return change_cameras(cameras, changes, f"{self.metadata_part}.cameras")

    def _change_faults(self, faults: FaultsConfig, metadata: Metadata) -> FaultsConfig:
        changes = (metadata or {}).get("faults", {})
        path = f"{self.metadata_part}.faults"
        if not isinstance(changes, Mapping):
            expected = f"a mapping of {', '.join(sorted(FaultsConfig.model_fields))}"
            raise InvalidInputError(f"metadata.{path}", changes, expected)
        return override(faults, changes, path)

    def _use_cameras(self, cameras: Cameras) -> None:
        """Set the cameras; `sensors` stays the same object if nothing changed."""
        if cameras != self._cameras:
            self._cameras, self.sensors = cameras, self._describe(cameras)

    def _use_faults(self, faults: FaultsConfig) -> None:
        self._faults = faults
        self.depth_faults, self._drift_sigmas = faults.of_depth, faults.drift_sigmas

    def _describe(self, cameras: Cameras) -> tuple[SensorInfo, ...]:
        from_left_m = {name: self._baselines_m[name] for name in self._rights}
        return tuple(sensor_info(camera, from_left_m.get(camera.name, 0.0)) for camera in cameras)


_MOTIONS: TypeAdapter[AnyMotion] = TypeAdapter(AnyMotion)
