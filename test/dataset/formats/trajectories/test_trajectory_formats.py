"""Other programs' readers get our poses, times, cameras and images from TUM, EuRoC and KITTI."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from evo.tools import file_interface
from rendered_datasets import rig_sensors, write_rendered_dataset

from oaisys_core.errors import InvalidInputError
from oaisys_core.output.images import read_image
from oaisys_core.types import FloatArray
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.trajectories.euroc import EurocFormat
from oaisys_dataset.formats.trajectories.kitti import KittiFormat
from oaisys_dataset.formats.trajectories.sequences import LOST_DEPTH
from oaisys_dataset.formats.trajectories.tum import TumFormat
from oaisys_dataset.manifest import FrameRecord

VIEWS = 4
OPTIONS = ExportOptions()


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two worlds seen by four cameras, one of which renders every other view only."""
    folder = tmp_path_factory.mktemp("rig")
    write_rendered_dataset(folder, {0: "train", 1: "val"}, VIEWS, rig_sensors())
    return open_dataset(folder)


@pytest.fixture(scope="module")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("stereo")
    sensors = {"stereo": rig_sensors()["stereo"]}
    write_rendered_dataset(folder, {0: "train", 1: "val"}, VIEWS, sensors)
    return open_dataset(folder)


def records_of(dataset: Dataset, world: int, sensor: str) -> list[FrameRecord]:
    return [record for record in dataset.of_world(world) if record.sensor == sensor]


def poses_of(records: list[FrameRecord]) -> FloatArray:
    return np.array([record.pose for record in records])


def stamps_of(records: list[FrameRecord]) -> FloatArray:
    return np.array([record.stamp_s for record in records])


@pytest.mark.parametrize("sensor", ["stereo_left", "stereo_right", "wide"])
def test_evo_reads_tum_trajectories(rig: Dataset, tmp_path: Path, sensor: str) -> None:
    counts = TumFormat().write(rig, tmp_path, OPTIONS)
    assert (counts["sequences"], counts["frames"]) == (8, len(rig))
    for world in rig.worlds:
        records = records_of(rig, world, sensor)
        path = tmp_path / f"world_{world:06d}_{sensor}" / "groundtruth.txt"
        trajectory = file_interface.read_tum_trajectory_file(path)
        np.testing.assert_allclose(trajectory.poses_se3, poses_of(records), atol=1e-12)
        np.testing.assert_allclose(trajectory.timestamps, stamps_of(records), atol=1e-6)


def test_tum_images_are_those_of_the_data_set(rig: Dataset, tmp_path: Path) -> None:
    units_per_m = 1000.0
    options = ExportOptions(settings={"depth_per_m": f"{units_per_m}"})
    TumFormat().write(rig, tmp_path, options)
    folder = tmp_path / "world_000001_wide"
    rows = np.loadtxt(folder / "associated.txt", dtype=str)
    assert len(rows) == VIEWS // 2
    for (stamp, color, same_stamp, depth), record in zip(
        rows, records_of(rig, 1, "wide"), strict=True
    ):
        assert stamp == same_stamp == f"{record.stamp_s:.6f}"
        sample = rig.sample(record)
        assert np.array_equal(cv2.imread(str(folder / color))[..., ::-1], sample.arrays["rgb"])
        units = cv2.imread(str(folder / depth), cv2.IMREAD_UNCHANGED)
        assert units.dtype == np.uint16
        depth_m = sample.arrays["depth"]
        fits = depth_m * units_per_m < 65535
        assert fits.any()
        assert not fits.all()
        np.testing.assert_allclose(
            units[fits] / units_per_m, depth_m[fits], atol=0.51 / units_per_m
        )
        assert not units[~fits].any()
    camera = records_of(rig, 1, "wide")[0].camera
    calibration = np.loadtxt(folder / "calibration.txt")
    focal_and_centre = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    assert calibration.tolist() == [*focal_and_centre, *camera.distortion]


def test_depth_that_does_not_fit_is_zero_and_counted(rig: Dataset, tmp_path: Path) -> None:
    counts = TumFormat().write(rig, tmp_path, ExportOptions(settings={"depth_per_m": "6553.5"}))
    depths_m = [rig.sample(record, ("depth",)).arrays["depth"] for record in rig.records]
    far = sum(int(np.count_nonzero(np.isfinite(d) & (d > 10.00001))) for d in depths_m)
    assert far > 0
    assert counts[LOST_DEPTH] == pytest.approx(far, abs=len(depths_m))
    with pytest.raises(InvalidInputError, match="depth_per_m"):
        TumFormat().write(rig, tmp_path, ExportOptions(settings={"depth_per_m": "0"}))


def test_evo_reads_euroc_trajectories_and_mounts_lead_to_every_camera(
    rig: Dataset, tmp_path: Path
) -> None:
    EurocFormat().write(rig, tmp_path, OPTIONS)
    for world in rig.worlds:
        folder = tmp_path / f"world_{world:06d}" / "mav0"
        file = folder / "state_groundtruth_estimate0/data.csv"
        trajectory = file_interface.read_euroc_csv_trajectory(file)
        stamps_s = stamps_of(records_of(rig, world, "turned"))
        np.testing.assert_allclose(trajectory.timestamps, stamps_s, atol=1e-9)
        sensors = list(dict.fromkeys(record.sensor for record in rig.of_world(world)))
        assert len(sensors) == 4
        body = poses_of(records_of(rig, world, sensors[0]))
        views = slice(None, None, VIEWS // len(body))
        np.testing.assert_allclose(trajectory.poses_se3[views], body, atol=1e-12)
        for number, sensor in enumerate(sensors):
            records = records_of(rig, world, sensor)
            calibration = yaml.safe_load((folder / f"cam{number}/sensor.yaml").read_text())
            T_body_camera = np.reshape(calibration["T_BS"]["data"], (4, 4))
            stamps_ns = np.rint(trajectory.timestamps * 1e9)
            by_stamp = dict(zip(stamps_ns, trajectory.poses_se3, strict=True))
            found = [by_stamp[round(r.stamp_s * 1e9)] @ T_body_camera for r in records]
            np.testing.assert_allclose(found, poses_of(records), atol=1e-6)
            camera = records[0].camera
            assert calibration["resolution"] == [camera.width_px, camera.height_px]
            focal_and_centre = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
            assert calibration["intrinsics"] == focal_and_centre
            coefficients = list(camera.distortion or [0.0] * 5)
            found_coefficients = calibration["distortion_coefficients"]
            assert [*found_coefficients, 0.0][:5] == coefficients
            assert len(found_coefficients) == (5 if coefficients[4] else 4)


def test_euroc_images_are_those_of_the_data_set(rig: Dataset, tmp_path: Path) -> None:
    EurocFormat().write(rig, tmp_path, OPTIONS)
    folder = tmp_path / "world_000000/mav0"
    number = [record.sensor for record in rig.of_world(0)].index("wide")
    rows = np.loadtxt(folder / f"cam{number}/data.csv", dtype=str, delimiter=",")
    depths = np.loadtxt(folder / f"depth{number}/data.csv", dtype=str, delimiter=",")
    records = records_of(rig, 0, "wide")
    for (stamp_ns, color), (_, depth), record in zip(rows, depths, records, strict=True):
        assert int(stamp_ns) == round(record.stamp_s * 1e9)
        files = rig.files(record)
        assert (folder / f"cam{number}/data" / color).read_bytes() == files["rgb"]
        image = read_image(folder / f"depth{number}/data" / depth, "depth")
        assert depth.endswith(".exr")
        assert np.array_equal(image, rig.sample(record, ["depth"]).arrays["depth"])


def test_evo_reads_kitti_poses_relative_to_the_first(stereo: Dataset, tmp_path: Path) -> None:
    counts = KittiFormat().write(stereo, tmp_path, OPTIONS)
    assert (counts["sequences"], counts["frames"]) == (2, len(stereo))
    described = json.loads((tmp_path / "sequences.json").read_text())
    for world, name in enumerate(("00", "01")):
        assert described[name]["world"] == world
        path = file_interface.read_kitti_poses_file(tmp_path / f"poses/{name}.txt")
        records = records_of(stereo, world, "stereo_left")
        np.testing.assert_allclose(path.poses_se3[0], np.eye(4), atol=1e-12)
        found = np.array(described[name]["T_map_first"]) @ np.array(path.poses_se3)
        np.testing.assert_allclose(found, poses_of(records), atol=1e-12)


def test_a_kitti_sequence_has_the_layout_that_pykitti_reads(
    stereo: Dataset, tmp_path: Path
) -> None:
    """The steps are those of `pykitti.odometry`: files by glob, times, matrices, baseline."""
    KittiFormat().write(stereo, tmp_path, OPTIONS)
    folder = tmp_path / "sequences/01"
    lefts, rights = (sorted((folder / f"image_{i}").glob("*.png")) for i in (2, 3))
    times = [
        dt.timedelta(seconds=float(line))
        for line in (folder / "times.txt").read_text().splitlines()
    ]
    assert len(lefts) == len(rights) == len(times) == VIEWS
    calibration = {}
    for line in (folder / "calib.txt").read_text().splitlines():
        key, value = line.split(":", 1)
        calibration[key] = np.array([float(x) for x in value.split()]).reshape(3, 4)
    assert set(calibration) == {"P0", "P1", "P2", "P3", "Tr"}
    left, right = (records_of(stereo, 1, f"stereo_{side}") for side in ("left", "right"))
    baseline_m = -calibration["P3"][0, 3] / calibration["P3"][0, 0]
    apart_m = np.linalg.norm(left[0].pose[:3, 3] - right[0].pose[:3, 3])
    assert baseline_m == pytest.approx(apart_m, rel=1e-9)
    assert np.array_equal(calibration["P2"][:, :3], left[0].camera.K)
    for files, records in ((lefts, left), (rights, right)):
        for file, record in zip(files, records, strict=True):
            assert file.read_bytes() == stereo.files(record)["rgb"]
    point_m = np.linalg.inv(right[0].pose) @ left[0].pose @ (0.3, -0.2, 5.0, 1.0)
    by_camera = right[0].camera.K @ point_m[:3]
    by_file = calibration["P3"] @ (0.3, -0.2, 5.0, 1.0)
    np.testing.assert_allclose(by_file / by_file[2], by_camera / by_camera[2], atol=1e-9)


def test_kitti_refuses_lenses_that_distort(rig: Dataset, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"world_000000_wide: distortion"):
        KittiFormat().write(rig, tmp_path, OPTIONS)
