"""Lidar scans in exports: other programs get our points and poses, or README.md says what lacks."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import webdataset
from small_datasets import LIDARS, SCANNED, render_dataset

from oaisys_core.geometry import transform_points
from oaisys_core.output.reader import read_samples
from oaisys_core.types import FloatArray, LidarScan
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.cli.export import write_export
from oaisys_dataset.formats.base import LEFT_OUT_SCANS, ExportOptions
from oaisys_dataset.formats.export import export_dataset

VIEWS = 3


def scans_of(dataset: Dataset, world: int, lidar: str) -> list[LidarScan]:
    return [dataset.scan(r) for r in dataset.scans.of_world(world) if r.sensor == lidar]


def matrices(path: Path) -> dict[str, FloatArray]:
    """Return the matrices of a ``calib.txt`` as pykitti does."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        key, value = line.split(":", 1)
        found[key] = np.vstack((np.reshape(np.fromstring(value, sep=" "), (3, 4)), (0, 0, 0, 1)))
    return found


def test_points_of_kitti_lie_where_the_lidar_found_them(scanned: Dataset, tmp_path: Path) -> None:
    counts = export_dataset(scanned, "kitti", tmp_path / "out")
    assert (counts["lidar scans"], counts[LEFT_OUT_SCANS]) == (6, 10)
    described = json.loads((tmp_path / "out/sequences.json").read_text(encoding="utf-8"))
    for name, sequence in described.items():
        folder = tmp_path / "out/sequences" / name
        T_first_camera = np.loadtxt(tmp_path / f"out/poses/{name}.txt").reshape(-1, 3, 4)
        T_camera_lidar = matrices(folder / "calib.txt")["Tr"]
        files = sorted((folder / "velodyne").glob("*.bin"))
        scans = scans_of(scanned, sequence["world"], "roof")
        assert [file.name for file in files] == ["000000.bin", "000001.bin", "000002.bin"]
        for file, T, scan in zip(files, T_first_camera, scans, strict=True):
            points = np.fromfile(file, np.float32).reshape(-1, 4)
            T_map_camera = np.array(sequence["T_map_first"]) @ np.vstack((T, (0, 0, 0, 1)))
            found_m = transform_points(T_map_camera @ T_camera_lidar, points[:, :3])
            expected_m = transform_points(scan.T_map_lidar, scan.points_m)
            np.testing.assert_allclose(found_m, expected_m, atol=1e-9)
            np.testing.assert_array_equal(points[:, 3], scan.data["intensity"] / np.float32(255))
            assert points[:, 3].max() <= 1


def test_h5py_reads_all_scans(scanned: Dataset, tmp_path: Path) -> None:
    counts = export_dataset(scanned, "hdf5", tmp_path / "out")
    assert counts == {"worlds": 2, "frames": 6, "lidar scans": 16}
    with h5py.File(tmp_path / "out/val/world_000001.h5") as file:
        for lidar, views in {"roof": [0, 1, 2], "front": [0, 2], "rosette": [0, 1, 2]}.items():
            group, scans = file[lidar], scans_of(scanned, 1, lidar)
            first = group["first"][...]
            assert list(group["view"]) == views
            assert list(group["stamp_s"]) == views
            assert len(first) == len(scans) + 1
            for number, scan in enumerate(scans):
                points = group["points"][first[number] : first[number + 1]]
                assert points.dtype == scan.data.dtype
                assert points.tobytes() == scan.data.tobytes()
                assert np.array_equal(group["T_map_lidar"][number], scan.T_map_lidar)
            assert group["points"].compression == "gzip"
            assert group["scan_id"].asstr()[0] == f"000001_0000_{lidar}"


def test_the_layout_of_render_has_the_scans(scanned: Dataset, tmp_path: Path) -> None:
    export_dataset(scanned, "files", tmp_path / "out")
    for world in scanned.worlds:
        samples = list(read_samples(tmp_path / f"out/batch_{world + 1:04d}"))
        assert len(samples) == VIEWS
        for sample, record in zip(samples, scanned.of_world(world), strict=True):
            expected = scanned.scans_beside(record)
            assert [scan.sensor for scan in sample.scans] == list(expected)
            for scan in sample.scans:
                assert scan.data.tobytes() == expected[scan.sensor].data.tobytes()
                assert np.array_equal(scan.T_map_lidar, expected[scan.sensor].T_map_lidar)


def test_webdataset_reads_all_scans(scanned: Dataset, tmp_path: Path) -> None:
    counts = export_dataset(scanned, "webdataset", tmp_path / "out")
    assert (counts["frames"], counts["lidar scans"], counts["tar files"]) == (6, 16, 4)
    assert LEFT_OUT_SCANS not in counts
    card = (tmp_path / "out/data_card.html").read_text(encoding="utf-8")
    assert "roof (6), front (4), rosette (6)" in card
    index = pq.read_table(tmp_path / "out/index_scans.parquet").to_pylist()
    assert [row["scan_id"] for row in index] == [record.scan_id for record in scanned.scans]
    for split in scanned.splits:
        tar = str(tmp_path / f"out/scans-{split}-000000.tar")
        found = list(webdataset.WebDataset(tar, shardshuffle=False).decode())
        for group, record in zip(found, scanned.split(split).scans, strict=True):
            scan, arrays = scanned.scan(record), group["points.npz"]
            assert group["__key__"] == group["json"]["scan_id"] == record.scan_id
            assert np.array_equal(group["json"]["T_map_lidar"], scan.T_map_lidar)
            assert np.array_equal(arrays["points_m"], scan.points_m)
            for name in set(scan.data.dtype.names or ()) - {"x", "y", "z"}:
                assert arrays[name].tobytes() == scan.data[name].tobytes(), name
    row = index[5]
    with (tmp_path / "out" / row["tar"]).open("rb") as file:
        file.seek(row["offset_points"])
        points = np.load(io.BytesIO(file.read(row["size_points"])))["points_m"]
    assert len(points) == row["count"] > 0


def test_what_is_told_of_an_export_separates_what_was_left_out(
    scanned: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_export(scanned, "kitti", str(tmp_path / "some"), ExportOptions())
    assert "; 6 frames; 6 lidar scans; 10 lidar scans, left out" in capsys.readouterr().out
    render_dataset(tmp_path / "one", {0: "train"}, 1, {**SCANNED, **_with_lidars(LIDARS[:1])})
    one = open_dataset(tmp_path / "one")
    write_export(one, "kitti", str(tmp_path / "all"), ExportOptions())
    assert "left out" not in capsys.readouterr().out


def _with_lidars(lidars: list[dict[str, Any]]) -> dict[str, Any]:
    return {"sensors": {**SCANNED["sensors"], "lidars": lidars}}


@pytest.mark.parametrize("name", ["coco", "tum", "euroc", "colmap", "nerfstudio"])
def test_other_formats_say_what_they_leave_out(scanned: Dataset, tmp_path: Path, name: str) -> None:
    counts = export_dataset(scanned.split("val"), name, tmp_path / "out")
    assert counts[LEFT_OUT_SCANS] == 8
    assert f"| {LEFT_OUT_SCANS} | 8 |" in (tmp_path / "out/README.md").read_text(encoding="utf-8")
    card = (tmp_path / "out/data_card.html").read_text(encoding="utf-8")
    assert "Lidar scans" not in card
