"""Lidar scans of data sets: written without loss, read back, repeated, checked."""

from __future__ import annotations

import shutil
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from small_datasets import SCANNED, render_dataset

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import NotFoundError
from oaisys_core.simulation import Simulation
from oaisys_core.types import LidarScan, point_dtype
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.check import CheckReport, check_dataset
from oaisys_dataset.repeat import repeat_records
from oaisys_dataset.scans import EncodedScan, ScanRecord, encode_scan_points
from oaisys_dataset.shards import (
    encode_frame,
    manifest_name,
    scans_name,
    tar_name,
    writing_shard,
)

WORLDS = {0: "train", 1: "val"}
VIEWS = 3
SCANS_PER_WORLD = 3 + 2 + 3


@pytest.fixture
def folder(scanned: Dataset, tmp_path: Path) -> Path:
    copy = tmp_path / "set"
    shutil.copytree(scanned.place.url, copy)
    return copy


def test_scans_are_those_of_the_simulation_point_by_point(scanned: Dataset) -> None:
    assert len(scanned.scans) == 2 * SCANS_PER_WORLD
    simulation = Simulation(config_from_mapping(SCANNED))
    for world in scanned.worlds:
        simulation.restore({"last_batch_id": world, "batch": None})
        simulation.step_batch(seed=1000 + world)
        for view in range(VIEWS):
            expected = simulation.step_sample().scans
            found = scanned.scans_beside(scanned.record(f"{world:06d}_{view:04d}_camera"))
            assert list(found) == [scan.sensor for scan in expected]
            assert ("front" in found) == (view != 1)
            for scan in expected:
                assert len(scan.data)
                assert found[scan.sensor].data.dtype == scan.data.dtype
                assert found[scan.sensor].data.tobytes() == scan.data.tobytes()
                np.testing.assert_array_equal(found[scan.sensor].T_map_lidar, scan.T_map_lidar)
    simulation.close()


def test_a_split_has_the_scans_of_its_worlds(scanned: Dataset) -> None:
    val = scanned.split("val")
    assert {scan.world for scan in val.scans} == {1}
    assert len(val.scans) == SCANS_PER_WORLD
    assert val.scans[0].scan_id == "000001_0000_roof"
    assert val.scans[-1] == scanned.scan_record("000001_0002_rosette")
    assert ScanRecord.from_json(val.scans[0].to_json()) == val.scans[0]
    assert scanned.scan_record("000001_0001_front") is None
    assert scanned.scan_record(f"{'9' * 5000}_0000_roof") is None
    with pytest.raises(NotFoundError):
        val.scans.of_world(0)


def test_other_programs_read_the_points_in_a_shard(scanned: Dataset, tmp_path: Path) -> None:
    with tarfile.open(Path(scanned.place.url, tar_name(0))) as tar:
        assert tar.getnames()[-1] == "legend.json"
        points = tar.extractfile("000000_0001_roof.points.pcd")
        assert points is not None
        (tmp_path / "roof.pcd").write_bytes(points.read())
    cloud = o3d.t.io.read_point_cloud(str(tmp_path / "roof.pcd"))
    scan = scanned.scans_beside(scanned.record("000000_0001_camera"))["roof"]
    np.testing.assert_array_equal(cloud.point.positions.numpy(), scan.points_m)


def test_a_view_without_images_keeps_its_scans_and_the_legend_is_found(tmp_path: Path) -> None:
    camera = {**SCANNED["sensors"]["cameras"][0], "step_interval": 2}
    config = {**SCANNED, "sensors": {**SCANNED["sensors"], "cameras": [camera]}}
    render_dataset(tmp_path, {0: "train"}, 2, config)
    dataset = open_dataset(tmp_path)
    assert [record.view for record in dataset.records] == [0]
    assert {scan.view for scan in dataset.scans} == {0, 1}
    assert dataset.legend(0).labels
    report = check_dataset(tmp_path, worlds_rebuilt=1)
    assert report.findings == ()


def test_scans_are_made_again_from_their_lines(scanned: Dataset) -> None:
    ids = ["000000_0001_roof", "000001_0002_rosette", "000001_0002_camera"]
    results = dict(repeat_records(scanned, ids, 40.0))
    assert list(results) == ids
    for comparisons in results.values():
        assert all(each.is_equal and not each.different_px for each in comparisons)
    (roof,) = results["000000_0001_roof"]
    record = scanned.scan_record("000000_0001_roof")
    assert record is not None
    assert (roof.name.modality, roof.pixels) == ("points", record.points.count)


def test_what_was_scanned_passes_the_check(scanned: Dataset) -> None:
    report = check_dataset(scanned.place.url, worlds_rebuilt=1)
    assert report.findings == ()
    assert (report.frames, report.scans) == (6, 2 * SCANS_PER_WORLD)
    assert report.scan_points > 3 * 300
    assert [note for note in report.notes if "rosette" in note]


def rewritten(
    folder: Path, world: int, change: Callable[[ScanRecord, LidarScan], tuple[ScanRecord, Any]]
) -> None:
    """Write a world again as if its scans had been made like this: all hashes are right."""
    dataset = open_dataset(folder)
    samples = [dataset.sample(record) for record in dataset.of_world(world)]
    scans = [(record, dataset.scan(record)) for record in dataset.scans.of_world(world)]
    legend = dataset.legend(world)
    with writing_shard(dataset.place, world) as shard:
        for sample in samples:
            shard.add_encoded(encode_frame(sample.record, sample.arrays))
        for record, scan in scans:
            changed, data = change(record, scan)
            points, file = encode_scan_points(
                changed.scan_id, LidarScan(changed.sensor, data, changed.pose)
            )
            shard.add_scan(EncodedScan(replace(changed, points=points), file))
        shard.finish(legend)


def flip_point_byte(folder: Path) -> None:
    points = open_dataset(folder).scans[2].points
    file = folder / tar_name(0)
    data = bytearray(file.read_bytes())
    data[points.offset + points.size - 10] ^= 1
    file.write_bytes(data)


def drop_scan_line(folder: Path) -> None:
    file = folder / scans_name(1)
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    file.write_text("".join(lines[:3] + lines[4:]), encoding="utf-8")


def change_scan_line(folder: Path) -> None:
    file = folder / scans_name(1)
    file.write_text(file.read_text(encoding="utf-8").replace('"view":1', '"view":2'))


def drop_scans(folder: Path) -> None:
    (folder / scans_name(0)).unlink()


def unknown_label(folder: Path) -> None:
    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        data = scan.data.copy()
        if "label" in (data.dtype.names or ()):
            data["label"][3] = 999
        return record, data

    rewritten(folder, 0, change)


def infinite_point(folder: Path) -> None:
    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        data = scan.data.copy()
        data["x"][0] = np.inf
        return record, data

    rewritten(folder, 0, change)


def other_fields(folder: Path) -> None:
    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        names = point_dtype().names
        return record, scan.data[list(names or ())].astype(point_dtype())

    rewritten(folder, 0, change)


def scale_points(folder: Path) -> None:
    """Write points that are 0.2 % too far away."""

    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        data = scan.data.copy()
        for axis in "xyz":
            data[axis] *= np.float32(1.002)
        return record, data

    rewritten(folder, 0, change)


def forget_motion(folder: Path) -> None:
    """Correct points for the motion during the scan, as they must not be."""

    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        data = scan.data.copy()
        if record.sensor == "roof" and record.view:
            data["time"] = 0
        return record, data

    rewritten(folder, 0, change)


def mirror_axes(folder: Path) -> None:
    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        data = scan.data.copy()
        data["y"] *= -1
        return record, data

    rewritten(folder, 0, change)


def turn_lidar(folder: Path) -> None:
    """Write poses for a lidar whose x axis points to the left."""

    def change(record: ScanRecord, scan: LidarScan) -> tuple[ScanRecord, Any]:
        turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        T = record.pose @ turn
        return replace(record, T_map_lidar=tuple(map(tuple, T.tolist()))), scan.data

    rewritten(folder, 0, change)


DAMAGE = [
    (flip_point_byte, {"hash"}),
    (drop_scan_line, {"manifest", "missing"}),
    (change_scan_line, {"manifest", "missing"}),
    (drop_scans, {"manifest", "missing"}),
    (unknown_label, {"legend"}),
    (infinite_point, {"image"}),
    (other_fields, {"manifest"}),
    (scale_points, {"surface"}),
    (forget_motion, {"surface"}),
    (mirror_axes, {"surface"}),
    (turn_lidar, {"camera", "surface"}),
]

NEED_WORLDS = {"camera", "surface", "other_fields"}
"""Checks for which worlds are made again, which takes seconds."""


def checks(report: CheckReport) -> set[str]:
    return {finding.check for finding in report.findings}


def _case(damage: Callable[[Path], None], expected: set[str]) -> Any:
    needs_worlds = (expected | {damage.__name__}) & NEED_WORLDS
    marks = [pytest.mark.long] if needs_worlds else []
    return pytest.param(damage, expected, bool(needs_worlds), id=damage.__name__, marks=marks)


@pytest.mark.parametrize(("damage", "expected", "needs_worlds"), [_case(*each) for each in DAMAGE])
def test_damage_of_scans_is_found(
    folder: Path, damage: Callable[[Path], None], expected: set[str], needs_worlds: bool
) -> None:
    damage(folder)
    if needs_worlds:  # what is damaged is in world 0
        (folder / manifest_name(1)).unlink()
    report = check_dataset(folder, worlds_rebuilt=int(needs_worlds))
    assert not report.has_passed
    assert expected <= checks(report), report.findings
