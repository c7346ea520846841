"""KITTI's object labels, read by a reader written from the benchmark's readme alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from object_worlds import object_config, true_meshes
from PIL import Image
from small_datasets import LIDARS, render_dataset

from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset


class Label(NamedTuple):
    """A line of KITTI's label file."""

    kind: str
    truncated: float
    occluded: int
    alpha: float
    box: NDArray[np.float64]
    height: float
    width: float
    length: float
    location: NDArray[np.float64]
    rotation_y: float


def read_labels(path: Path) -> list[Label]:
    found = []
    for line in path.read_text().splitlines():
        kind, *rest = line.split(" ")
        v = [float(each) for each in rest]
        assert len(v) == 14
        box, location = np.array(v[3:7]), np.array(v[10:13])
        found.append(Label(kind, v[0], int(v[1]), v[2], box, v[7], v[8], v[9], location, v[13]))
    return found


def read_calib(path: Path) -> dict[str, NDArray[np.float64]]:
    lines = [line.split(": ") for line in path.read_text().splitlines() if line]
    return {name: np.array(text.split(), float).reshape(3, -1) for name, text in lines}


def corners(label: Label) -> NDArray[np.float64]:
    """Return the (8, 3) corners of a box, as KITTI's own tool computes them."""
    along, up, across = label.length / 2, label.height, label.width / 2
    points = [(x, y, z) for x in (-along, along) for y in (0, -up) for z in (-across, across)]
    c, s = np.cos(label.rotation_y), np.sin(label.rotation_y)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.asarray(np.array(points) @ R.T + label.location)


@pytest.fixture(scope="module")
def exported(known: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("kitti") / "out"
    export_dataset(known, "kitti_object", target)
    return target


def test_labels_have_the_objects_dimensions_places_and_directions(
    known: Dataset, exported: Path
) -> None:
    frames = json.loads((exported / "frames.json").read_text())
    meshes, seen = true_meshes(), set()
    for number, frame_id in frames.items():
        record = known.record(frame_id)
        T_camera_map = np.linalg.inv(record.pose)
        labels = read_labels(exported / f"training/label_2/{number}.txt")
        rows = known.objects(record)
        assert len(labels) == len(rows) > 0
        for label, row in zip(labels, rows, strict=True):
            seen.add(label.kind)
            assert label.kind == row.label
            T = T_camera_map @ row.T_map_object
            local = np.array(meshes[label.kind].vertices)
            local = (local - row.T_map_object[:3, 3]) @ row.T_map_object[:3, :3]
            low, high = local.min(axis=0), local.max(axis=0)
            size = label.length, label.width, label.height
            np.testing.assert_allclose(size, high - low, atol=3e-3)
            bottom = np.append((low + high)[:2] / 2, low[2])
            np.testing.assert_allclose(label.location, T[:3, :3] @ bottom + T[:3, 3], atol=3e-3)
            x_axis = T[:3, 0] - T[:3, 0] * (0, 1, 0)
            x_axis /= np.linalg.norm(x_axis)
            turned = np.cos(label.rotation_y), 0, -np.sin(label.rotation_y)
            np.testing.assert_allclose(turned, x_axis, atol=1e-4)
            toward = np.arctan2(label.location[0], label.location[2])
            apart = label.rotation_y - toward - label.alpha
            assert np.cos(apart) == pytest.approx(1)
            assert -np.pi <= label.alpha <= np.pi
            assert -np.pi <= label.rotation_y <= np.pi
            assert label.truncated == pytest.approx(row.truncation, abs=1e-3)
            assert label.occluded == (0 if row.occlusion <= 0.05 else 1 + (row.occlusion > 0.5))
            image = np.asarray(Image.open(exported / f"training/image_2/{number}.png"))
            left, top, right, bottom_px = label.box
            assert 0 <= left <= right <= image.shape[1] - 1
            assert 0 <= top <= bottom_px <= image.shape[0] - 1
            ids = known.sample(record, ["instance"]).arrays["instance"]
            v, u = np.nonzero(ids == row.instance_id)
            assert left <= u.min()
            assert right >= u.max()
            assert top <= v.min()
            assert bottom_px >= v.max()
    assert seen == set(meshes)


def test_level_labels_enclose_upright_objects_in_the_image(known: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(settings={"frame": "level"})
    export_dataset(known, "kitti_object", tmp_path / "out", options)
    meshes, judged = true_meshes(), 0
    for path in sorted((tmp_path / "out/training/label_2").iterdir()):
        P2 = read_calib(tmp_path / f"out/training/calib/{path.stem}.txt")["P2"]
        record = known.record(json.loads((tmp_path / "out/frames.json").read_text())[path.stem])
        for label in read_labels(path):
            if label.kind != "wedge":
                continue
            judged += 1
            projected = np.column_stack((corners(label), np.ones(8))) @ P2.T
            uv = projected[:, :2] / projected[:, 2:]
            # The wedge stands upright, so the box touches its vertices.
            T = np.linalg.inv(record.pose)
            points = meshes["wedge"].vertices @ T[:3, :3].T + T[:3, 3]
            seen = points @ record.camera.K.T
            seen = seen[:, :2] / seen[:, 2:]
            assert (uv.min(axis=0) <= seen.min(axis=0) + 0.05).all()
            assert (uv.max(axis=0) >= seen.max(axis=0) - 0.05).all()
            nearest = np.linalg.norm(uv[:, None] - seen[None], axis=2).min(axis=0)
            assert np.sort(nearest)[:4].max() < 0.05
    assert judged


def test_lists_calibration_and_points_are_those_of_the_frames(tmp_path: Path) -> None:
    camera = {"name": "camera", "width_px": 64, "height_px": 48, "modalities": ["rgb", "instance"]}
    config = object_config(tmp_path, {"cameras": [camera], "lidars": LIDARS[:1]})
    render_dataset(tmp_path / "set", {0: "train", 1: "val"}, 2, config)
    dataset = open_dataset(tmp_path / "set")
    counts = export_dataset(dataset, "kitti_object", tmp_path / "out")
    assert counts["lidar scans"] == 4
    lists = {
        split: (tmp_path / f"out/ImageSets/{split}.txt").read_text().split()
        for split in ("train", "val")
    }
    assert lists == {"train": ["000000", "000001"], "val": ["000002", "000003"]}
    for number, sample in zip([*lists["train"], *lists["val"]], dataset, strict=True):
        calib = read_calib(tmp_path / f"out/training/calib/{number}.txt")
        assert list(calib) == [
            *("P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo")
        ]
        np.testing.assert_array_equal(calib["P2"][:, :3], sample.K)
        file = tmp_path / f"out/training/velodyne/{number}.bin"
        points = np.fromfile(file, np.float32).reshape(-1, 4)
        scan = dataset.scans_beside(sample.record)["roof"]
        np.testing.assert_allclose(points[:, :3], scan.points_m, atol=1e-4)
        in_camera = points[:, :3] @ calib["Tr_velo_to_cam"][:, :3].T + calib["Tr_velo_to_cam"][:, 3]
        T = np.linalg.inv(sample.T_map_camera) @ scan.T_map_lidar
        np.testing.assert_allclose(in_camera, scan.points_m @ T[:3, :3].T + T[:3, 3], atol=1e-3)


def test_objects_below_the_settings_are_dont_care(known: Dataset, tmp_path: Path) -> None:
    options = ExportOptions(settings={"min_visible": "0.9", "min_area": "20"})
    counts = export_dataset(known, "kitti_object", tmp_path / "out", options)
    frames, cared = json.loads((tmp_path / "out/frames.json").read_text()), 0
    for number, frame_id in frames.items():
        labels = read_labels(tmp_path / f"out/training/label_2/{number}.txt")
        for label, row in zip(labels, known.objects(known.record(frame_id)), strict=True):
            counts_ = row.visible_px >= 20 and row.visible_share >= 0.9
            assert (label.kind == row.label) == counts_
            assert (label.kind == "DontCare") != counts_
            cared += counts_
    assert cared
    assert counts["objects below min_visible, left out"] > 0


def test_sequences_of_kitti_have_the_same_labels(known: Dataset, tmp_path: Path) -> None:
    export_dataset(known, "kitti", tmp_path / "out")
    export_dataset(known, "kitti_object", tmp_path / "object")
    sequences = json.loads((tmp_path / "out/sequences.json").read_text())
    frames = json.loads((tmp_path / "object/frames.json").read_text())
    compared = 0
    for name, sequence in sequences.items():
        for place, frame_id in enumerate(sequence["frame_ids"]):
            (number,) = [n for n, each in frames.items() if each == frame_id]
            mine = tmp_path / f"out/sequences/{name}/label_2/{place:06d}.txt"
            other = tmp_path / f"object/training/label_2/{number}.txt"
            assert mine.read_text() == other.read_text()
            compared += 1
    assert compared == len(known)
