"""The check of one world's manifests: the lines of its frames and of its lidar scans."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.sensing.cameras import CameraConfig
from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.errors import OaisysError
from oaisys_core.geometry import is_rigid
from oaisys_core.output.records import pose_from_record, provenance_from_record
from oaisys_core.types import POINTS
from oaisys_dataset.check.report import ShardResult
from oaisys_dataset.manifest import DatasetInfo, FrameRecord
from oaisys_dataset.manifest_lines import RecordT
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.records import SensorRecord, frame_id, is_intact
from oaisys_dataset.scans import ScanRecord
from oaisys_dataset.shards import HEAD, manifest_name, scans_name


class DueViews(NamedTuple):
    """The views at which each sensor of the rig must have measured, by its name.

    Attributes:
        cameras, lidars: The views of each.
        modalities: What each camera must have rendered at each of its views.
    """

    cameras: Mapping[str, Sequence[int]]
    lidars: Mapping[str, Sequence[int]]
    modalities: Mapping[str, Mapping[int, frozenset[str]]]


def due_views(info: DatasetInfo) -> DueViews:
    """Return the views at which sensors are due by their intervals.

    Raises:
        ConfigError: The configuration of the data set cannot be used here.
    """
    config = config_from_mapping(info.config)
    sensors, renders = config.sensors, config.render.renders
    modalities = {
        camera.name: _modalities_of(camera, filter(renders, camera.modalities), info.views)
        for camera in sensors.all_cameras
    }
    return DueViews(
        {name: list(views) for name, views in modalities.items()},
        {lidar.name: list(_due(lidar, info.views)) for lidar in sensors.lidars},
        modalities,
    )


def _due(sensor: CameraConfig | LidarConfig, views: int) -> range:
    return range(sensor.step_offset, views, sensor.step_interval)


def _modalities_of(
    camera: CameraConfig, modalities: Iterable[str], views: int
) -> dict[int, frozenset[str]]:
    """Return what a camera renders at each view at which it renders anything."""
    names, every = list(modalities), camera.modality_intervals
    turns = {
        view: frozenset(name for name in names if turn % every.get(name, 1) == 0)
        for turn, view in enumerate(_due(camera, views))
    }
    return {view: due for view, due in turns.items() if due}


def check_manifests(
    place: StoragePlace, info: DatasetInfo, due: DueViews, result: ShardResult
) -> tuple[list[FrameRecord], list[ScanRecord]]:
    """Return the frames and scans of a world whose records can be read."""
    name = manifest_name(result.world)
    frames = _check_lines(
        place, name, FrameRecord.from_json, lambda frame: _check_frame(frame, info, result), result
    )
    result.records = len(frames)
    if not frames:
        result.note("manifest", name, "it has no frame")
    scans: list[ScanRecord] = []
    of_scans = scans_name(result.world)
    if due.lidars and place.exists(of_scans):
        scans = _check_lines(
            place, of_scans, ScanRecord.from_json, lambda s: _check_scan(s, info, result), result
        )
    _check_world([*frames, *scans], result)
    if frames:
        _check_views(frames, due.cameras, name, result)
        _check_modalities(frames, due, result)
    _check_views(scans, due.lidars, of_scans, result)
    return frames, scans


def _check_lines(
    place: StoragePlace,
    name: str,
    parse: Callable[[bytes, str], RecordT],
    check: Callable[[RecordT], None],
    result: ShardResult,
) -> list[RecordT]:
    """Return the records that can be read."""
    *lines, rest = place.read(name).split(b"\n")
    if rest:
        result.note("manifest", name, f"its last line is cut off: {rest[:40]!r}")
    records = []
    for number, line in enumerate(lines, start=1):
        where = f"{name}:{number}"
        try:
            record = parse(line, where)
            check(record)
        except (OaisysError, KeyError, TypeError, ValueError) as error:
            result.note("manifest", where, str(error))
            continue
        if not is_intact(line):
            result.note("manifest", record.id, "the line was changed: its hash differs")
        records.append(record)
    return records


def _check_frame(record: FrameRecord, info: DatasetInfo, result: ShardResult) -> None:
    """Compare a record with itself, with its world and with the head of the data set."""
    name = record.frame_id
    _check_origin(record, info, result)
    camera, T = record.camera, record.pose
    if not np.array_equal(camera.K, record.intrinsics["K"]):
        result.note("camera", name, "K differs from its focal lengths and principal point")
    if not is_rigid(T):
        result.note("camera", name, "T_map_camera is no rigid transform")
    size = (camera.height_px, camera.width_px)
    for modality, image in record.images.items():
        if image.shape[:2] != size:
            text = f"{image.shape[1]}x{image.shape[0]} pixels, its camera has {size[1]}x{size[0]}"
            result.note("image", f"{name}/{modality}", text)
        _check_file(image.file, name, modality, result)


def _check_scan(record: ScanRecord, info: DatasetInfo, result: ShardResult) -> None:
    """Compare a record with itself, with its world and with the head of the data set."""
    _check_origin(record, info, result)
    if not is_rigid(record.pose):
        result.note("camera", record.scan_id, "T_map_lidar is no rigid transform")
    _check_file(record.points.file, record.scan_id, POINTS, result)


def _check_origin(record: SensorRecord, info: DatasetInfo, result: ShardResult) -> None:
    """Compare what says where a record is from."""
    name = record.id
    expected_id = frame_id(result.world, record.view, record.sensor)
    if name != expected_id or record.world != result.world:
        result.note("manifest", name, f"received world {record.world}, expected {expected_id}")
    provenance = provenance_from_record(record.provenance)
    pose_from_record(record.rig_pose)
    for sha256 in {record.config_sha256, provenance.config_sha256} - {info.config_sha256}:
        text = f"configuration {sha256[:12]}, expected {info.config_sha256[:12]} of dataset.json"
        result.note("manifest", name, text)
    if provenance.batch_seed != record.world_seed:
        text = f"provenance has seed {provenance.batch_seed}, the record {record.world_seed}"
        result.note("manifest", name, text)
    if record.split not in info.splits:
        result.note("split", name, f"{record.split!r}, expected one of {', '.join(info.splits)}")


def _check_file(file: str, name: str, modality: str, result: ShardResult) -> None:
    if not file.startswith(f"{name}.{modality}."):
        text = f"its file is {file}, expected one of this sensor and modality"
        result.note("manifest", f"{name}/{modality}", text)


def _check_world(records: Sequence[SensorRecord], result: ShardResult) -> None:
    """Check that a world has one split and one seed, and that no id comes twice."""
    for each, count in Counter(record.id for record in records).items():
        if count > 1:
            result.note("manifest", each, f"{count} lines have this id")
    result.splits = {record.split for record in records}
    result.seeds = {record.world_seed for record in records}
    name = manifest_name(result.world)
    if len(result.splits) > 1:
        text = f"a world belongs to one split, its frames to {', '.join(sorted(result.splits))}"
        result.note("split", name, text)
    if len(result.seeds) > 1:
        result.note("manifest", name, "its frames have different seeds of the world")


def _check_views(
    records: Sequence[SensorRecord],
    due: Mapping[str, Sequence[int]],
    name: str,
    result: ShardResult,
) -> None:
    """Check that each sensor has measured at each view at which it was due."""
    found = {(record.sensor, record.view) for record in records}
    for sensor, views in due.items():
        missing = [view for view in views if (sensor, view) not in found]
        if missing:
            shown = ", ".join(map(str, missing[:5]))
            text = f"{len(missing)} of {len(views)} views of {sensor}: {shown}"
            result.note("missing", name, text)
    for record in records if due else ():
        if record.view not in due.get(record.sensor, ()):
            text = f"nothing is due of {record.sensor!r} at view {record.view}, as {HEAD} says"
            result.note("manifest", record.id, text)


def _check_modalities(frames: Sequence[FrameRecord], due: DueViews, result: ShardResult) -> None:
    """Check that each frame has the images that its camera renders at its view."""
    for frame in frames:
        expected = due.modalities.get(frame.sensor, {}).get(frame.view)
        if expected is not None and frame.images.keys() != expected:
            text = f"{', '.join(sorted(frame.images))}; expected {', '.join(sorted(expected))}"
            result.note("missing", f"{frame.frame_id}: modalities", text)
