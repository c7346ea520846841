"""The check of lidar scans against the world that they show: their points are on its surface."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig
from oaisys_core.geometry import pose_to_matrix, transform_points
from oaisys_core.output.records import (
    motion_to_record,
    pose_from_record,
    previous_rig_poses,
    provenance_from_record,
)
from oaisys_core.scene import PoseAtTime
from oaisys_core.types import FloatArray, LidarScan, point_dtype
from oaisys_core.world.modules.lidars import lidar_info, motion_during_scan, sensor_poses
from oaisys_dataset.check.report import DatasetFinding
from oaisys_dataset.check.true_surface import POSE_TOLERANCE, WorldSurface
from oaisys_dataset.reader import Dataset
from oaisys_dataset.scans import ScanRecord

POINTS = 500
"""Random points of a scan that must be on the surface."""


class ScanCheck:
    """Compares the scans of a data set with the surface of their worlds.

    Attributes:
        notes: What is not judged.
    """

    def __init__(self, config: SimulationConfig, rng: np.random.Generator) -> None:
        self._configs = {lidar.name: lidar for lidar in config.sensors.lidars}
        self._infos = {lidar.name: lidar_info(lidar) for lidar in config.sensors.lidars}
        self._rng = rng
        is_noisy = config.sensors.faults.enabled
        self._inexact = {
            lidar.name
            for lidar in config.sensors.lidars
            if lidar.beam_divergence_mrad > 0 or (is_noisy and lidar.faults.range_sigma_m > 0)
        }
        self.notes = tuple(
            f"points of {name} have range noise or beam divergence and are not judged"
            for name in sorted(self._inexact)
        )

    def check(
        self, dataset: Dataset, record: ScanRecord, surface: WorldSurface
    ) -> tuple[int, list[DatasetFinding]]:
        """Return how many points of a scan were compared, and what was found."""
        info = self._infos.get(record.sensor)
        if info is None:
            text = f"the rig has no lidar {record.sensor!r}"
            return 0, [DatasetFinding("camera", record.scan_id, text)]
        findings = list(self._origin_faults(record))
        if record.sensor in self._inexact:
            return 0, findings
        scan = dataset.scan(record)
        chosen = self._rng.permutation(len(scan.data))[:POINTS]
        points_m = self._points_in_map(record, scan, chosen)
        ranges_m = np.linalg.norm(scan.points_m[chosen], axis=1)
        judged, stray = surface.stray(points_m, ranges_m)
        if surface.is_wrong(judged, stray):
            text = f"{stray} of {judged} random points are not on the surface of the world"
            findings.append(DatasetFinding("surface", record.scan_id, text))
        return judged, findings

    def _origin_faults(self, record: ScanRecord) -> Iterator[DatasetFinding]:
        """Yield how a lidar's pose and fields differ from those of the rig."""
        info = self._infos[record.sensor]
        T_map_base = pose_to_matrix(pose_from_record(record.rig_pose))
        off = np.abs(T_map_base @ info.T_base_lidar - record.pose).max()
        if not off <= POSE_TOLERANCE:
            text = f"T_map_lidar is {off:.3g} off the rig's pose with this lidar"
            yield DatasetFinding("camera", record.scan_id, text)
        expected = point_dtype(info.extra_fields).names
        if record.points.fields != expected:
            text = f"fields {record.points.fields}, expected {expected}"
            yield DatasetFinding("manifest", record.scan_id, text)

    def _points_in_map(
        self, record: ScanRecord, scan: LidarScan, chosen: NDArray[np.int64]
    ) -> FloatArray:
        """Return points in ``map``, each by the lidar's pose at the time of its ray."""
        points_m = scan.points_m[chosen]
        motion = self._motion(record, scan.T_map_lidar)
        if motion is None:
            return transform_points(scan.T_map_lidar, points_m)
        poses = motion(scan.data["time"][chosen].astype(np.float64))
        turned = np.einsum("nij,nj->ni", poses[:, :3, :3], points_m)
        return np.asarray(turned + poses[:, :3, 3])

    def _motion(self, record: ScanRecord, T_map_lidar: FloatArray) -> PoseAtTime | None:
        """Return the lidar's motion during a scan; None if it stands still."""
        how, name = provenance_from_record(record.provenance), record.sensor
        T_base_lidar = self._infos[name].T_base_lidar
        motion = motion_to_record(how)
        if motion is not None:
            return partial(sensor_poses, motion, T_base_lidar)
        previous, config = previous_rig_poses(how).get(name), self._configs[name]
        if previous is None or not config.sweep_share:
            return None
        return motion_during_scan(config, pose_to_matrix(previous) @ T_base_lidar, T_map_lidar)
