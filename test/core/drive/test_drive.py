"""Drives, recorded to files: what was due is there, and the files agree with each other."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping
from oaisys_core.drive.drive import Drive
from oaisys_core.output.writer import SampleWriter
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory.files import read_trajectory, write_poses
from oaisys_core.verification.recorded_samples import compare, open_records

OAISYS = Path(sys.executable).with_name("oaisys")

CONFIG: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 40, "resolution_px": 65},
    "materials": {"texture_size_px": 16, "mask": {"size_px": 16, "relief": 0}},
    "assets": {"rocks": []},
    "sensors": {
        "cameras": [
            {"name": "front", "mount_position_m": [0.5, 0, 1.5], "rate_hz": 10.0},
            {"name": "side", "mount_position_m": [0, 0.4, 1.5], "rate_hz": 4.0},
        ],
        "lidars": [
            {"scan": {"kind": "raster", "columns": 8, "rows": 4}, "rate_hz": 5.0, "period_s": 0.1}
        ],
        "imus": [{"name": "imu", "rate_hz": 100.0, "gyroscope_noise_density": 1e-4}],
    },
    "drive": {
        "waypoints_m": [[-6, -4], [0, 0], [6, 1]],
        "duration_s": 1.0,
        "gravity": "moon",
        "odometry_rate_hz": 20.0,
    },
}
for camera in CONFIG["sensors"]["cameras"]:
    camera |= {"width_px": 32, "height_px": 24, "fx_px": 27, "fy_px": 27, "modalities": ["depth"]}


def config_file(folder: Path, **drive: Any) -> Path:
    path = folder / "drive.yaml"
    path.write_text(yaml.safe_dump({**CONFIG, "drive": {**CONFIG["drive"], **drive}}))
    return path


def oaisys(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [OAISYS, *map(str, arguments)],
        env={**os.environ, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_drive_records_every_measurement_that_was_due(tmp_path: Path) -> None:
    out = tmp_path / "out"
    files_alone = ("--no-bag", "--no-report")
    result = oaisys("drive", "--config", config_file(tmp_path), "--out", out, *files_alone)
    assert result.returncode == 0, result.stderr
    report = json.loads((out / "drive.json").read_text())
    # The lidar's last scan begins at 0.8 s.
    expected = {"front": 10, "side": 4, "lidar": 5, "imu": 100, "odometry": 20}
    assert report["due"] == report["recorded"] == expected
    assert len(list((out / "batch_0001/front").glob("*depth*.exr"))) == 10
    assert len(list((out / "batch_0001/side").glob("*depth*.exr"))) == 4
    assert len(list((out / "batch_0001/lidar").glob("*.pcd"))) == 5
    stamps = rows(out / "batch_0001/stamps.csv")
    assert [row["sensors"] for row in stamps].count("front side") == 1
    assert [row["sensors"] for row in stamps].count("front side lidar") == 1
    assert [int(row["sample_id"]) for row in stamps] == list(range(1, 13))

    trajectory = read_trajectory(out / "trajectory.csv")
    times_s = np.array([int(row["t_ns"]) for row in stamps]) / 1e9
    recorded = np.array([[float(row[k]) for k in ("x_m", "y_m", "z_m")] for row in poses(out)])
    assert recorded == pytest.approx(trajectory.position_m(times_s), abs=1e-9)

    truth = read_trajectory(out / "ground_truth.tum")
    odometry = rows(out / "odometry.csv")
    assert len(odometry) == 20
    forward = np.array([float(row["vx_m_s"]) for row in odometry])
    at_s = np.array([float(row["t_s"]) for row in odometry])
    speed = np.linalg.norm(trajectory.velocity_m_s(at_s), axis=1)
    assert forward == pytest.approx(speed, abs=0.02)  # a rover moves along its x axis
    assert truth.positions_m == pytest.approx(trajectory.position_m(at_s), abs=1e-9)

    (lines,) = [np.loadtxt(out / "imu/data.csv", delimiter=",", comments="#")]
    assert lines.shape == (100, 7)
    up = trajectory.rotation(lines[:3, 0] / 1e9).inv().apply((0.0, 0.0, 1.624))
    assert lines[:3, 4:] == pytest.approx(up, abs=0.05)  # at rest


def poses(out: Path) -> list[dict[str, str]]:
    return rows(out / "batch_0001/poses.csv")


def rise(folder: Path, sensors: dict[str, Any]) -> tuple[Simulation, Drive, float]:
    """Return a rig that rises at 2 m/s above a plane, from 2 m on, and the plane's height."""
    way = folder / "up.csv"
    write_poses(way, np.array([(t, 0, 0, 2 + 2 * t, 0, 0, 0, 1) for t in (0.0, 0.5, 1.0)]))
    drive = {"vehicle": {"kind": "file", "path": str(way)}}
    stage = {**CONFIG["stage"], "preset": "plane"}
    config = config_from_mapping({**CONFIG, "stage": stage, "sensors": sensors, "drive": drive})
    simulation = Simulation(config)
    simulation.step_batch()
    ground_m = simulation.query_height([(0.0, 0.0, 0.0)]).ground_height_m[0]
    return simulation, Drive(simulation, config), float(ground_m)


def test_each_ray_of_a_lidar_starts_where_the_vehicle_is_at_its_time(tmp_path: Path) -> None:
    """A rig that rises at 2 m/s above a plane: z of a point is minus the height at its time."""
    scan = {"kind": "raster", "columns": 40, "rows": 30, "vertical_fov_deg": 90}
    sensors = {"cameras": CONFIG["sensors"]["cameras"][:1], "lidars": [{"scan": scan}]}
    simulation, made, ground_m = rise(tmp_path, sensors)
    for step in made.samples():
        if "lidar" in step.sensors:
            points = step.sample.scan("lidar").data
            assert len(points) > 100
            height_m = 2 + 2 * (step.time_ns / 1e9 + points["time"]) - ground_m
            assert points["z"] == pytest.approx(-height_m, abs=2e-3)
            assert np.ptp(points["time"]) > 0.03
    simulation.close()


def test_each_row_of_a_rolling_shutter_is_seen_from_where_the_vehicle_is_at_its_time(
    tmp_path: Path,
) -> None:
    """A rig that rises at 2 m/s above a plane, and looks down."""
    down = {"mount_quat_xyzw": [0, np.sqrt(0.5), 0, np.sqrt(0.5)], "mount_position_m": [0, 0, 0]}
    camera = {**CONFIG["sensors"]["cameras"][0], **down, "readout_s": 0.05, "exposure_s": 0.01}
    sensors = {"cameras": [camera]}
    simulation, made, ground_m = rise(tmp_path, sensors)
    for step in made.samples():
        rows_s = step.time_ns / 1e9 + np.linspace(0, 0.05, 24)
        depth_m = step.sample.frame("front", "depth").data
        expected_m = np.broadcast_to((2 + 2 * rows_s - ground_m)[:, None], depth_m.shape)
        np.testing.assert_allclose(depth_m, expected_m, rtol=1e-5)
    simulation.close()
    # The exposure of the first image begins before the way does.
    motion = made.motion_about(0, ["front"])
    assert motion is not None
    heights_m = motion(np.array((-0.005, 0.0, 0.055)))[:, 2, 3]
    np.testing.assert_allclose(heights_m, (1.99, 2.0, 2.11), atol=1e-9)


@pytest.mark.long
def test_the_samples_of_a_drive_repeat_to_the_byte_though_the_rig_moved(tmp_path: Path) -> None:
    front = {**CONFIG["sensors"]["cameras"][0], "readout_s": 0.04, "exposure_s": 0.01}
    sensors = {**CONFIG["sensors"], "cameras": [front]}
    way: dict[str, Any] = {"vehicle": {"kind": "rover", "speed_m_s": 3.0, "acceleration_m_s2": 5.0}}
    way |= {"duration_s": 0.5, "waypoints_m": [[-6, -4], [-5.5, -3], [-4, -3]]}
    drive = {**CONFIG["drive"], **way}
    config = config_from_mapping({**CONFIG, "sensors": sensors, "drive": drive})
    simulation = Simulation(config)
    simulation.step_batch()
    sample = list(Drive(simulation, config).samples())[-1].sample
    SampleWriter(tmp_path).write(sample)
    (record,) = open_records(tmp_path / "batch_0001").read([(1, sample.sample_id)])
    again = simulation.repeat(record.outline)
    assert [each.name.modality for each in compare(record, again, 40.0)] == ["depth", "points"]
    assert all(each.is_equal for each in compare(record, again, 40.0))
    # Without the motion, the same record gives other bytes.
    how = record.outline.provenance
    assert 500 < len(how.motion_json) < 6000
    still = simulation.repeat(replace(record.outline, provenance=replace(how, motion_json="")))
    assert not any(each.is_equal for each in compare(record, still, 40.0))
    simulation.close()


@pytest.mark.long
def test_a_planned_trajectory_can_be_driven_from_its_file(tmp_path: Path) -> None:
    planned = tmp_path / "planned.tum"
    result = oaisys("drive", "plan", config_file(tmp_path), "--out", planned)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("the way: ")
    trajectory = read_trajectory(planned)
    assert trajectory.position_m(trajectory.end_s)[0, :2] == pytest.approx((6, 1), abs=1e-3)
    tilt = Rotation.from_quat(trajectory.quats_xyzw).as_matrix()[:, 2, 2]
    assert (tilt > np.cos(np.radians(30))).all()

    drive = {"vehicle": {"kind": "file", "path": str(planned)}, "waypoints_m": []}
    again = tmp_path / "again.csv"
    result = oaisys("drive", "plan", config_file(tmp_path, **drive), "--out", again)
    assert result.returncode == 0, result.stderr
    assert (read_trajectory(again).positions_m == trajectory.positions_m).all()


@pytest.mark.long
def test_a_way_that_cannot_be_driven_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    config = config_file(tmp_path, waypoints_m=[[0, 0], [30, 0]])
    result = oaisys("drive", "--config", config, "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "a way with all wheels on the stage" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_drive_without_an_image_or_a_scan_is_refused(tmp_path: Path) -> None:
    config = config_file(tmp_path, duration_s=0.05)
    slow = yaml.safe_load(config.read_text())
    for camera in slow["sensors"]["cameras"]:
        camera["readout_s"] = 0.1
    config.write_text(yaml.safe_dump(slow))
    result = oaisys("drive", "--config", config, "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "expected a drive so long that an image or a scan is due" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_configuration_without_a_drive_is_refused(tmp_path: Path) -> None:
    result = oaisys("drive", "--out", tmp_path / "out", "--backend", "analytic")
    assert result.returncode == 2
    assert "drive: received None, expected a section" in result.stderr


def test_a_file_as_the_folder_is_refused_before_the_drive_is_planned(tmp_path: Path) -> None:
    (tmp_path / "out").touch()
    result = oaisys("drive", "--config", config_file(tmp_path), "--out", tmp_path / "out")
    assert result.returncode == 2
    assert result.stderr.startswith("oaisys: out: received "), result.stderr
    assert "the way" not in result.stderr


def test_a_drive_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    result = oaisys("drive", "--out", tmp_path / "out", "--backend", "analytic")
    assert result.returncode == 2
    assert not (tmp_path / "out").exists()
