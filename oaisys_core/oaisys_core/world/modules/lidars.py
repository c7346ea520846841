"""The lidars of a rig: where they are, how they move during a scan, and what they scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import radians

import numpy as np
import scipy

from oaisys_core import geometry
from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.procedural.lidar_patterns import scan_pattern
from oaisys_core.scene import LidarErrors, PlacedLidar, PoseAtTime
from oaisys_core.types import FloatArray, LidarInfo, Pose

Lidars = tuple[LidarConfig, ...]


def lidar_info(lidar: LidarConfig) -> LidarInfo:
    """Return a lidar as clients see it."""
    mount = geometry.check_pose(
        lidar.mount_position_m, lidar.mount_quat_xyzw, f"sensors.lidars.{lidar.name}.mount"
    )
    T_base_lidar = geometry.pose_to_matrix(mount)
    return LidarInfo(lidar.name, T_base_lidar, lidar.period_s, lidar.extra_fields)


def place_lidars(
    lidars: Lidars, infos: Sequence[LidarInfo], rig_pose: Pose, number: int, has_errors: bool
) -> tuple[PlacedLidar, ...]:
    """Return the lidars in ``map``, standing still.

    Args:
        lidars: Their configuration.
        infos: Their descriptions.
        rig_pose: Pose of the rig.
        number: Number of the scan, from 0.
        has_errors: Whether they have their configured errors.
    """
    T_map_base = geometry.pose_to_matrix(rig_pose)
    return tuple(
        PlacedLidar(
            name=lidar.name,
            pattern=scan_pattern(lidar, number),
            T_map_lidar=T_map_base @ info.T_base_lidar,
            min_range_m=lidar.min_range_m,
            max_range_m=lidar.max_range_m,
            reference_range_m=lidar.reference_range_m,
            beam_divergence_rad=lidar.beam_divergence_mrad / 1000,
            return_separation_m=lidar.return_separation_m,
            extra_fields=lidar.extra_fields,
            errors=_errors(lidar) if has_errors else LidarErrors(),
            depends_on_past=lidar.sweep_share > 0,
        )
        for lidar, info in zip(lidars, infos, strict=True)
    )


def with_motion(
    placed: Sequence[PlacedLidar],
    lidars: Lidars,
    infos: Sequence[LidarInfo],
    last_rig_poses: Mapping[str, Pose],
) -> tuple[PlacedLidar, ...]:
    """Return the lidars; one that scans in motion has its motion since its last scan.

    Args:
        placed: The lidars that scan.
        lidars: The configuration of all lidars of the rig.
        infos: Their descriptions.
        last_rig_poses: By sensor name, the pose of the rig when that sensor last rendered.
    """
    configs = {lidar.name: lidar for lidar in lidars}
    mounts = {info.name: info.T_base_lidar for info in infos}
    moving = []
    for lidar in placed:
        before, config = last_rig_poses.get(lidar.name), configs[lidar.name]
        if before is not None and lidar.depends_on_past:
            T_map_before = geometry.pose_to_matrix(before) @ mounts[lidar.name]
            motion = motion_during_scan(config, T_map_before, lidar.T_map_lidar)
            lidar = replace(lidar, pose_at=motion)  # noqa: PLW2901
        moving.append(lidar)
    return tuple(moving)


def motion_during_scan(
    lidar: LidarConfig, T_map_before: FloatArray, T_map_lidar: FloatArray
) -> ConstantVelocity:
    """Return the motion of a lidar that goes on as it came from its previous scan's pose.

    Args:
        lidar: Its configuration, with a ``sweep_share`` above 0.
        T_map_before, T_map_lidar: Its (4, 4) poses at the beginning of both scans.
    """
    interval_s = lidar.period_s / lidar.sweep_share
    return ConstantVelocity.between(T_map_before, T_map_lidar, interval_s)


def following(
    placed: Sequence[PlacedLidar], infos: Sequence[LidarInfo], T_map_base: PoseAtTime
) -> tuple[PlacedLidar, ...]:
    """Return the lidars, moving with the rig during their scans.

    Args:
        placed: The lidars that scan.
        infos: The descriptions of all lidars of the rig.
        T_map_base: Poses of the rig at times since the sample's own.
    """
    mounts = {info.name: info.T_base_lidar for info in infos}
    return tuple(
        replace(lidar, pose_at=partial(sensor_poses, T_map_base, mounts[lidar.name]))
        for lidar in placed
    )


def sensor_poses(
    T_map_base: PoseAtTime, T_base_sensor: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Return the (T, 4, 4) poses of a sensor on a rig at (T,) times."""
    return np.asarray(T_map_base(times_s) @ T_base_sensor)


@dataclass(frozen=True)
class ConstantVelocity:
    """A `PoseAtTime`: constant velocity in ``map`` and constant angular rate in the body's frame.

    Attributes:
        T_map_body: (4, 4) pose at time 0.
        velocity_m_s: (3,) in ``map``.
        rate_rad_s: (3,) rotation vector per second, in the body's frame.
    """

    T_map_body: FloatArray
    velocity_m_s: FloatArray
    rate_rad_s: FloatArray

    @classmethod
    def between(
        cls, T_map_before: FloatArray, T_map_now: FloatArray, interval_s: float
    ) -> ConstantVelocity:
        """Return the motion that led from one pose to another, and goes on from the latter."""
        turn = scipy.spatial.transform.Rotation.from_matrix(
            T_map_before[:3, :3].T @ T_map_now[:3, :3]
        )
        shift_m = T_map_now[:3, 3] - T_map_before[:3, 3]
        return cls(T_map_now, shift_m / interval_s, turn.as_rotvec() / interval_s)

    def __call__(self, times_s: FloatArray) -> FloatArray:
        """Return the (T, 4, 4) poses at (T,) times."""
        turns = scipy.spatial.transform.Rotation.from_rotvec(np.outer(times_s, self.rate_rad_s))
        poses = np.tile(np.eye(4), (len(times_s), 1, 1))
        poses[:, :3, :3] = self.T_map_body[:3, :3] @ turns.as_matrix()
        poses[:, :3, 3] = self.T_map_body[:3, 3] + np.outer(times_s, self.velocity_m_s)
        return poses


def _errors(lidar: LidarConfig) -> LidarErrors:
    faults = lidar.faults
    start = None if faults.drop_from_deg is None else radians(faults.drop_from_deg)
    return LidarErrors(faults.seed, faults.range_sigma_m, start)
