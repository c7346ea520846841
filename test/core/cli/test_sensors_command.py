"""`oaisys sensors import`: a section that can be used as it is."""

from __future__ import annotations

from pathlib import Path

import yaml
from typer.testing import CliRunner

from oaisys_core.cli.sensors import sensors_app
from oaisys_core.config import load_config

CHAIN = """\
cam0:
  camera_model: pinhole
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  distortion_model: radtan
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  resolution: [752, 480]
  T_cam_imu: [[0, 0, 1, 0.1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
  timeshift_cam_imu: 0.01
"""


def test_a_chain_becomes_a_section_with_what_was_assumed(tmp_path: Path) -> None:
    (tmp_path / "camchain.yaml").write_text(CHAIN)
    out = tmp_path / "not yet" / "sensors.yaml"
    result = CliRunner().invoke(
        sensors_app, ["import", str(tmp_path / "camchain.yaml"), "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    text = out.read_text()
    assert "# From camchain.yaml (Kalibr camchain)." in text
    assert "# The IMU's frame is base_link." in text
    assert "# Timeshift_cam_imu is not used" in text
    camera = load_config(out).sensors.cameras[0]
    assert (camera.name, camera.width_px, camera.cx_px) == ("cam0", 752, 367.215)
    assert yaml.safe_load(text)["sensors"]["cameras"][0]["mount_position_m"] == [0.0, 0.0, -0.1]
