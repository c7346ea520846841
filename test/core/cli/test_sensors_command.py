"""`oaisys sensors import`: a section that can be used as it is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner, Result

from oaisys_core.cli.sensors import sensors_app
from oaisys_core.config import load_config
from oaisys_core.errors import InvalidInputError

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


ROVER = """
<robot name="rover">
  <link name="base_link"/><link name="mast"/><link name="mast_optical"/>
  <joint name="up" type="fixed">
    <parent link="base_link"/><child link="mast"/><origin xyz="0.3 0 0.9" rpy="0 0.2 0"/>
  </joint>
  <joint name="turned" type="fixed">
    <parent link="mast"/><child link="mast_optical"/>
    <origin rpy="-1.5707963267948966 0 -1.5707963267948966"/>
  </joint>
</robot>
"""
FRONT = """
image_width: 320
image_height: 240
camera_name: front
camera_matrix: {rows: 3, cols: 3, data: [280, 0, 158.2, 0, 281, 121.3, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [280, 0, 158.2, 0, 0, 281, 121.3, 0, 0, 0, 1, 0]}
"""


def import_rover(folder: Path, *options: str) -> Result:
    (folder / "rover.urdf").write_text(ROVER)
    (folder / "front.yaml").write_text(FRONT)
    out = str(folder / "rover.yaml")
    return CliRunner().invoke(
        sensors_app, ["import", str(folder / "rover.urdf"), *options, "--out", out]
    )


@pytest.mark.parametrize("link", ["mast", "mast_optical"])
def test_a_calibrated_camera_is_put_on_a_link(link: str, tmp_path: Path) -> None:
    result = import_rover(tmp_path, "--camera", f"{link}={tmp_path / 'front.yaml'}")
    assert result.exit_code == 0, result.output
    camera = load_config(tmp_path / "rover.yaml").sensors.cameras[0]
    assert (camera.name, camera.cx_px) == ("front", 158.2)
    assert camera.distortion is not None
    assert camera.distortion.k1 == -0.1
    assert camera.mount_position_m == pytest.approx((0.3, 0.0, 0.9))
    # Pitched down by 0.2 rad about y, whichever of the two frames is named.
    assert camera.mount_quat_xyzw == pytest.approx((0, math.sin(0.1), 0, math.cos(0.1)), abs=1e-9)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("mst=front.yaml", "did you mean mast?"),
        ("front.yaml", "expected LINK=FILE"),
        ("mast=rover.urdf", "with 0 cameras"),
    ],
)
def test_a_camera_that_cannot_be_put_is_refused(given: str, message: str, tmp_path: Path) -> None:
    link, equals, file = given.rpartition("=")
    result = import_rover(tmp_path, "--camera", f"{link}{equals}{tmp_path / file}")
    assert isinstance(result.exception, InvalidInputError)
    assert message in str(result.exception)


def test_a_camera_does_not_replace_another_that_is_given(tmp_path: Path) -> None:
    front = tmp_path / "front.yaml"
    result = import_rover(
        tmp_path, *("--camera", f"mast={front}"), "--camera", f"base_link={front}"
    )
    assert isinstance(result.exception, InvalidInputError)
    assert "not front twice" in str(result.exception)


def test_a_robot_without_sensors_says_how_it_gets_some(tmp_path: Path) -> None:
    assert "--camera LINK=FILE" in str(import_rover(tmp_path).exception)
