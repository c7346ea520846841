"""`oaisys drive` as a user runs it: its report, its options, and what independent programs find."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from repository import REPOSITORY

from oaisys_mapping.odometry.programs import program

OAISYS = Path(sys.executable).with_name("oaisys")
EXAMPLE = REPOSITORY / "config" / "examples" / "rover_drive.yaml"
SCALE_ERROR = 0.05


def drive(
    folder: Path, *options: str, environment: dict[str, str] | None = None, **changes: Any
) -> subprocess.CompletedProcess[str]:
    """Run the example for a few seconds, with the analytic backend and small sensors."""
    data = yaml.safe_load(EXAMPLE.read_text())
    data["backend"] = "analytic"
    data["assets"]["rocks"] = []
    data["materials"] = {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}}
    data["sensors"]["cameras"][0] |= {"width_px": 32, "height_px": 24, "fx_px": 27, "fy_px": 27}
    data["sensors"]["lidars"][0]["scan"] |= {"azimuth_steps": 120}
    data["drive"] |= {"duration_s": 3.0, **changes}
    config = folder / "drive.yaml"
    config.write_text(yaml.safe_dump(data))
    out = str(folder / "out")
    command = [str(OAISYS), "drive", "--config", str(config), "--out", out, *options]
    return subprocess.run(
        command,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.long
def test_the_report_tells_what_the_bag_and_other_programs_say(tmp_path: Path) -> None:
    for name in ("evo_ape", "kiss_icp_pipeline"):
        if program(name) is None:
            pytest.skip(f"{name} is not installed")
    result = drive(tmp_path, odometry_drift={"scale_error": SCALE_ERROR})
    assert result.returncode == 0, result.stderr
    out = tmp_path / "out"

    report = json.loads((out / "report.json").read_text())
    assert report["complete"]
    assert report["lost"] == []
    assert report["counts"]["bag"]["/imu/data_raw"] == {"due": 600, "written": 600}
    assert report["counts"]["files"]["lidar"] == {"due": 30, "written": 30}
    checks = {check["program"]: check for check in report["odometry_checks"]}
    assert set(checks) == {
        "evo",
        "kiss-icp",
        "kiss-icp without the points' times",
        "gtsam",
    }
    truth = np.loadtxt(out / "ground_truth.tum")[:, 1:4]
    expected_m = SCALE_ERROR * np.sqrt(np.mean(np.sum((truth - truth[0]) ** 2, axis=1)))
    assert checks["evo"]["figures"]["ape_rmse_m"] == pytest.approx(expected_m, rel=1e-4)
    assert checks["kiss-icp"]["figures"]["scans"] >= 29

    page = (out / "report.html").read_text()
    for text in ("Everything that was due is recorded", "/lidar/points", "data:image/png"):
        assert text in page
    pictures = {file.name for file in (out / "pictures").iterdir()}
    assert {"way.png", "odometry.png", "imu_imu.png", "camera_camera_rgb.jpg"} <= pictures


@pytest.mark.long
def test_files_alone_are_written_without_bag_and_report(tmp_path: Path) -> None:
    result = drive(tmp_path, "--no-bag", "--no-report", duration_s=0.5)

    assert result.returncode == 0, result.stderr
    out = tmp_path / "out"
    names = {file.name for file in out.iterdir()}
    assert names == {
        *("batch_0001", "config.yaml", "drive.json", "ground_truth.tum", "imu", "odometry.csv"),
        *("odometry.tum", "trajectory.csv"),
    }
    assert (out / "ground_truth.tum").read_text() == (out / "odometry.tum").read_text()


@pytest.mark.parametrize(("options", "exit_code"), [((), 0), (("--bag",), 2)])
def test_a_bag_that_cannot_be_had_is_said(
    tmp_path: Path, options: tuple[str, ...], exit_code: int
) -> None:
    """A Python without ROS: files are written anyway, unless the bag is demanded."""
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['rclpy'] = None\n")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])

    result = drive(
        tmp_path, "--no-report", *options, environment={"PYTHONPATH": path}, duration_s=0.5
    )

    assert result.returncode == exit_code, result.stderr
    assert "rclpy" in result.stderr
    assert (tmp_path / "out" / "drive.json").is_file() == (exit_code == 0)
