"""The check of images against the worlds that they show, which are made again from the manifest.

The worlds are made without Blender. Depth, labels and objects are compared with the audit's
reference; random pixels are carried to the map by depth, K and pose, and must be on the surface, as
must random points of lidar scans.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pixel_rays, pose_to_matrix, transform_points
from oaisys_core.output.records import pose_from_record
from oaisys_core.raycast.objects.views import ObjectFinder
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    DEPTH,
    DEPTH_TRUE,
    INSTANCE,
    Frame,
    SceneObject,
    SensorInfo,
    TriangleMesh,
)
from oaisys_core.verification.audit import AuditResult, audit_frames, sum_results
from oaisys_core.verification.reference_scene import ReferenceScene
from oaisys_core.world.batch import state_of
from oaisys_dataset.check.object_rows import CHECK, differing_rows
from oaisys_dataset.check.report import DatasetFinding
from oaisys_dataset.check.scan_truth import ScanCheck
from oaisys_dataset.check.true_surface import POSE_TOLERANCE, WorldSurface
from oaisys_dataset.check.view_truth import (
    draw_faults,
    legend_faults,
    light_faults,
    normal_faults,
    time_faults,
)
from oaisys_dataset.manifest import DatasetInfo, FrameRecord, WorldLegend
from oaisys_dataset.manifest_lines import RecordT
from oaisys_dataset.objects import frame_objects, rows_of
from oaisys_dataset.reader import Dataset, DatasetSample
from oaisys_dataset.rendering.world_render import all_objects, seconds_per_view
from oaisys_dataset.scans import ScanRecord

VIEWS = 3
"""Views of a rebuilt world whose images are audited."""

POINTS = 500
"""Random pixels of a frame that must be on the surface."""

LARGEST_WRONG_SHARE = 5e-4
"""Of audited pixels off edges, of one sensor and modality in one world."""


@dataclass
class TruthResult:
    """What was found in rebuilt worlds."""

    findings: list[DatasetFinding] = field(default_factory=list)
    audited: list[AuditResult] = field(default_factory=list)
    points: int = 0
    scan_points: int = 0


class TruthCheck:
    """Makes worlds of a data set again, and compares their frames with them.

    Attributes:
        notes: What is not judged.
    """

    def __init__(self, info: DatasetInfo, rng: np.random.Generator) -> None:
        """Set the simulation up.

        Raises:
            ConfigError: The configuration of the data set cannot be used here.
        """
        config = config_from_mapping(info.config)
        self._simulation = Simulation(config, AnalyticBackend())
        self._finder = ObjectFinder()
        self._rng = rng
        self._has_faults = config.sensors.faults.of_depth is not None
        self._scans = ScanCheck(config, rng)
        cameras = config.sensors.all_cameras
        self._rolling = frozenset(camera.name for camera in cameras if camera.readout_s)
        fisheyes = frozenset(camera.name for camera in cameras if camera.fisheye is not None)
        self._unaudited = self._rolling | fisheyes
        notes = ["depth has sensor faults and is not judged"] if self._has_faults else []
        notes += [f"{name} has a rolling shutter: not judged" for name in sorted(self._rolling)]
        notes += [f"{name} is a fisheye: labels are not judged" for name in sorted(fisheyes)]
        self.notes = (*notes, *self._scans.notes)

    def close(self) -> None:
        """Release the simulation."""
        self._simulation.close()

    def check(self, dataset: Dataset, world: int) -> TruthResult:
        """Compare the frames of a world with the world itself."""
        result = TruthResult()
        records = list(dataset.of_world(world))
        scans = list(dataset.scans.of_world(world)) if dataset.scans.has_world(world) else []
        legend = dataset.legend(world)
        views = sorted({record.view for record in records})
        chosen = self._rng.choice(views, min(VIEWS, len(views)), replace=False)
        surface, reference, geometry = None, None, ""
        for view in sorted(chosen.tolist()):
            of_view = [record for record in records if record.view == view]
            changes = of_view[0].provenance["metadata_json"]
            is_same = changes == geometry and not self._differs_by_view()
            if surface is None or reference is None or not is_same:
                geometry, mesh = changes, self._rebuilt(of_view[0])
                surface = WorldSurface(mesh, self._simulation.scene.ground.extent_m)
                reference = ReferenceScene(self._simulation.scene, mesh)
            self._check_legend(world, legend, result)
            self._check_views(of_view, result)
            self._audit_view(dataset, of_view, reference, surface, result)
            self._check_scans(dataset, [s for s in scans if s.view == view], surface, result)
        if chosen.size:
            result.findings += legend_faults(world, legend, self._objects())
        if surface is not None and not self._differs_by_view():
            for record in _others(records, chosen, geometry):
                depths = _only(record, DEPTH, DEPTH_TRUE)
                self._check_points(dataset.sample(record, depths), surface, result)
            others = _others(scans, chosen, geometry)
            self._check_scans(dataset, others, surface, result)
        self._judge(world, result)
        return result

    def _differs_by_view(self) -> bool:
        """Return whether the current world's surface is another one in each view."""
        config = self._simulation.world_config
        return bool(config.assets.movers) or config.stage.detail is not None

    def _objects(self) -> dict[int, SceneObject]:
        """Return all objects of the current world, by their ids."""
        return {each.instance_id: each for each in all_objects(self._simulation)}

    def _check_views(self, records: Sequence[FrameRecord], result: TruthResult) -> None:
        """Compare what records say of light and time with the current world."""
        sky, s_per_view = (
            self._simulation.scene.sky,
            seconds_per_view(self._simulation.world_config),
        )
        for record in records:
            result.findings += light_faults(record, (sky.sun_elevation_rad, sky.sun_azimuth_rad))
            result.findings += time_faults(record, s_per_view)
            result.findings += draw_faults(record, self._simulation.draws)

    def _rebuilt(self, record: FrameRecord) -> TriangleMesh:
        """Make the world of a frame again, as it was at that view, and return its surface."""
        self._simulation.restore(state_of(record.outline()))
        return self._simulation.ground_truth_mesh()

    def _audit_view(
        self,
        dataset: Dataset,
        records: Sequence[FrameRecord],
        reference: ReferenceScene,
        surface: WorldSurface,
        result: TruthResult,
    ) -> None:
        sensors = {sensor.name: sensor for sensor in self._simulation.info().sensors}
        for record in records:
            result.findings += _camera_faults(record, sensors)
            sample = dataset.sample(record)
            frames = [
                Frame(record.sensor, modality, data, record.camera, record.pose)
                for modality, data in sample.arrays.items()
                if modality != DEPTH or not self._has_faults
            ]
            if record.sensor not in self._unaudited:
                result.audited += audit_frames(frames, reference, self._rng)
            self._check_points(sample, surface, result)
            self._check_objects(dataset, sample, result)
            if record.sensor not in self._unaudited and not self._has_faults:
                result.findings += normal_faults(sample)

    def _check_objects(self, dataset: Dataset, sample: DatasetSample, result: TruthResult) -> None:
        """Compare a frame's rows of objects with those that the world gives."""
        record, ids = sample.record, sample.arrays.get(INSTANCE)
        if ids is None or not dataset.has_objects(record.world):
            return
        found = self._finder.find(self._simulation.scene, record.camera, record.pose, ids)
        wanted = rows_of(pa.Table.from_batches([frame_objects(record, found)]))
        for text in differing_rows(dataset.objects(record), wanted):
            result.findings.append(DatasetFinding(CHECK, record.frame_id, text))

    def _check_points(
        self, sample: DatasetSample, surface: WorldSurface, result: TruthResult
    ) -> None:
        """Check that random pixels of a frame are on the surface."""
        depth_m = sample.arrays.get(DEPTH_TRUE)
        if depth_m is None and not self._has_faults:
            depth_m = sample.arrays.get(DEPTH)
        if depth_m is None or sample.record.sensor in self._rolling:
            return
        rows, columns = np.nonzero(np.isfinite(depth_m))
        chosen = self._rng.permutation(len(rows))[:POINTS]
        rays = pixel_rays(sample.record.camera)[rows[chosen], columns[chosen]]
        in_camera_m = rays * depth_m[rows[chosen], columns[chosen], None]
        points_m = transform_points(sample.T_map_camera, in_camera_m)
        judged, stray = surface.stray(points_m, np.linalg.norm(in_camera_m, axis=1))
        result.points += judged
        if surface.is_wrong(judged, stray):
            text = f"{stray} of {judged} random pixels are not on the surface of the world"
            result.findings.append(DatasetFinding("surface", sample.record.frame_id, text))

    def _check_scans(
        self,
        dataset: Dataset,
        scans: Sequence[ScanRecord],
        surface: WorldSurface,
        result: TruthResult,
    ) -> None:
        for scan in scans:
            judged, findings = self._scans.check(dataset, scan, surface)
            result.scan_points += judged
            result.findings += findings

    def _check_legend(self, world: int, legend: WorldLegend, result: TruthResult) -> None:
        for label_id, label in self._simulation.info().semantic_labels.items():
            if legend.labels.get(label_id) != label:
                text = f"id {label_id} is {legend.labels.get(label_id)!r}, expected {label!r}"
                result.findings.append(DatasetFinding("legend", f"world {world}", text))

    def _judge(self, world: int, result: TruthResult) -> None:
        result.audited = sum_results(result.audited)
        for each in result.audited:
            if each.wrong_share > LARGEST_WRONG_SHARE:
                check = "surface" if each.modality in (DEPTH, DEPTH_TRUE) else "labels"
                text = (
                    f"{each.wrong_share:.4%} of {each.pixels} pixels off edges differ from the"
                    f" world, expected at most {LARGEST_WRONG_SHARE:.2%}"
                )
                subject = f"world {world}: {each.sensor}/{each.modality}"
                result.findings.append(DatasetFinding(check, subject, text))


def _others(
    records: Sequence[RecordT], chosen: Collection[int], metadata_json: str
) -> list[RecordT]:
    """Return the records of other views than the chosen ones, in the same state of the world."""
    others = [record for record in records if record.view not in chosen]
    return [each for each in others if each.provenance["metadata_json"] == metadata_json]


def _camera_faults(record: FrameRecord, sensors: dict[str, SensorInfo]) -> Iterator[DatasetFinding]:
    """Yield how a frame's camera differs from that of the rig at the recorded pose."""
    sensor = sensors.get(record.sensor)
    if sensor is None:
        yield DatasetFinding("camera", record.frame_id, f"the rig has no sensor {record.sensor!r}")
        return
    if record.camera != sensor.intrinsics:
        text = f"received {record.camera}, expected {sensor.intrinsics}"
        yield DatasetFinding("camera", record.frame_id, text)
    T_map_base = pose_to_matrix(pose_from_record(record.rig_pose))
    off = np.abs(T_map_base @ sensor.T_base_camera - record.pose).max()
    if not off <= POSE_TOLERANCE:
        text = f"T_map_camera is {off:.3g} off the rig's pose with this sensor"
        yield DatasetFinding("camera", record.frame_id, text)


def _only(record: FrameRecord, *modalities: str) -> list[Any]:
    return [modality for modality in modalities if modality in record.images]
