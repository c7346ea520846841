"""What of a calibration nobody reads is named, and no lens is dropped for a misspelt key."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.config import load_config
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.calibrations import read_calibration

K = [458.0, 0, 367, 0, 457, 248, 0, 0, 1]
RADTAN = [-0.28, 0.07, 0.0002, 0.00002]
T_BS = np.eye(4).ravel().tolist()
ROS: dict[str, Any] = {
    "image_width": 752,
    "image_height": 480,
    "camera_matrix": {"rows": 3, "cols": 3, "data": K},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [*RADTAN, 0.0]},
}
MESSAGE: dict[str, Any] = {
    "width": 752,
    "height": 480,
    "distortion_model": "plumb_bob",
    "d": [*RADTAN, 0.0],
    "k": K,
}
KALIBR: dict[str, Any] = {
    "camera_model": "pinhole",
    "intrinsics": [458.0, 457.0, 367.0, 248.0],
    "distortion_model": "radtan",
    "distortion_coeffs": RADTAN,
    "resolution": [752, 480],
    "rostopic": "/cam0/image_raw",
}
EUROC: dict[str, Any] = {
    "sensor_type": "camera",
    "T_BS": {"cols": 4, "rows": 4, "data": T_BS},
    "rate_hz": 20,
    "resolution": [752, 480],
    "camera_model": "pinhole",
    "intrinsics": [458.0, 457.0, 367.0, 248.0],
    "distortion_model": "radial-tangential",
    "distortion_coefficients": RADTAN,
}
KALIBR_IMU: dict[str, Any] = {
    "accelerometer_noise_density": 2.0e-3,
    "accelerometer_random_walk": 3.0e-3,
    "gyroscope_noise_density": 1.7e-4,
    "gyroscope_random_walk": 1.9e-5,
    "update_rate": 200.0,
}
NERF: dict[str, Any] = {
    "w": 752,
    "h": 480,
    "fl_x": 458.0,
    "k1": -0.1,
    "frames": [{"file_path": "0.png", "transform_matrix": np.eye(4).tolist()}],
}


def respelled(data: dict[str, Any], key: str, spelling: str) -> dict[str, Any]:
    return {spelling if name == key else name: value for name, value in data.items()}


def write(data: object, folder: Path, name: str = "sensor.yaml") -> Path:
    file = folder / name
    file.write_text(json.dumps(data) if name.endswith("json") else yaml.safe_dump(data))
    return file


WITHOUT_LENS = {
    "ros": (respelled(ROS, "distortion_coefficients", "distortion_coefs"), "distortion_coeff"),
    "ros, data": (
        ROS | {"distortion_coefficients": {"rows": 1, "cols": 5, "values": RADTAN}},
        "distortion_coefficients.data",
    ),
    "message": (respelled(MESSAGE, "d", "distortion"), "distortion_coefficients"),
    "kalibr": (
        {"cam0": respelled(KALIBR, "distortion_coeffs", "distortion_coefs")},
        "cam0.distortion_coeffs",
    ),
    "kalibr, model": (
        {"cam0": respelled(KALIBR, "distortion_model", "distortion_type")},
        "cam0.distortion_model",
    ),
    "euroc": (
        respelled(EUROC, "distortion_coefficients", "distortion_coeffs"),
        "distortion_coefficients",
    ),
    "euroc, model": (respelled(EUROC, "distortion_model", "model"), "distortion_model"),
}


@pytest.mark.parametrize("what", WITHOUT_LENS)
def test_a_model_of_a_lens_without_its_coefficients_is_refused(tmp_path: Path, what: str) -> None:
    data, field = WITHOUT_LENS[what]
    file = write(data, tmp_path)
    with pytest.raises(InvalidInputError, match=rf"calibration\.{field}.*key is missing"):
        read_calibration(file)
    world = tmp_path / "world.yaml"
    world.write_text(f"sensors: {{cameras: [{{calibration: {{file: {file.name}}}}}]}}\n")
    with pytest.raises(ConfigError, match=field):
        load_config(world)


@pytest.mark.parametrize(
    "data",
    [
        ROS | {"distortion_coefficients": {"rows": 1, "cols": 0, "data": []}},
        MESSAGE | {"d": [], "distortion_model": ""},
        {"cam0": {key: KALIBR[key] for key in KALIBR if key != "distortion_coeffs"}}
        | {"cam1": KALIBR | {"T_cn_cnm1": np.eye(4).tolist()}},
        EUROC | {"distortion_model": "none", "distortion_coefficients": []},
    ],
)
def test_a_lens_may_say_that_it_has_no_distortion(tmp_path: Path, data: dict[str, Any]) -> None:
    if "cam0" in data:
        data["cam0"]["distortion_model"] = "none"
    camera = read_calibration(write(data, tmp_path)).cameras[0]
    assert camera.distortion == {}
    assert camera.fisheye is None


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 9, 13])
def test_a_count_of_coefficients_that_no_model_has_is_refused(tmp_path: Path, count: int) -> None:
    values = {"rows": 1, "cols": count, "data": [0.01] * count}
    file = write(ROS | {"distortion_coefficients": values}, tmp_path)
    with pytest.raises(InvalidInputError, match=f"received '{count} coefficients', expected 0, 4"):
        read_calibration(file)
    if count != 4:
        file = write(
            ROS | {"distortion_model": "equidistant", "distortion_coefficients": values}, tmp_path
        )
        with pytest.raises(InvalidInputError, match=f"received '{count} coefficients', expected 0"):
            read_calibration(file)


UNREAD = {
    "ros": (ROS | {"camera_nam": "front"}, "sensor.yaml", ("camera_nam",)),
    "kalibr": (
        {"cam0": KALIBR | {"T_cam.imu": T_BS}, "camm1": KALIBR},
        "sensor.yaml",
        ("camm1", "cam0.T_cam.imu"),
    ),
    "kalibr imu": (respelled(KALIBR_IMU, "update_rate", "rate"), "sensor.yaml", ("rate",)),
    "kalibr imus": (
        {"imu0": KALIBR_IMU | {"T_ib": T_BS}, "imu_1": KALIBR_IMU},
        "sensor.yaml",
        ("imu_1", "imu0.T_ib"),
    ),
    "euroc": (respelled(EUROC, "rate_hz", "rate"), "sensor.yaml", ("rate",)),
    "nerf": (NERF | {"k_2": 0.3}, "transforms.json", ("k_2",)),
    "nerf frame": (
        NERF | {"frames": [NERF["frames"][0] | {"fl.y": 9.0}]},
        "transforms.json",
        ("fl.y",),
    ),
    "a line end": (ROS | {"a\nsensors: {}": 1}, "sensor.yaml", (r"'a\nsensors: {}'",)),
}


@pytest.mark.parametrize("what", UNREAD)
def test_keys_that_nobody_reads_are_named(tmp_path: Path, what: str) -> None:
    data, name, unused = UNREAD[what]
    file = write(data, tmp_path, name)
    assert read_calibration(file).unused == unused
    output = CliRunner().invoke(app, ["sensors", "import", str(file)]).output
    assert f"# Not used: {', '.join(unused)}" in output


@pytest.mark.parametrize("what", ["ros", "kalibr", "euroc", "nerf"])
def test_a_configuration_warns_of_keys_that_nobody_reads(
    tmp_path: Path, what: str, caplog: pytest.LogCaptureFixture
) -> None:
    data, name, unused = UNREAD[what]
    write(data, tmp_path, name)
    world = tmp_path / "world.yaml"
    world.write_text(f"sensors: {{cameras: [{{calibration: {{file: {name}}}}}]}}\n")
    load_config(world)
    assert f"{name}: not used: {', '.join(unused)}" in caplog.text


@pytest.mark.parametrize("suffix", ["yaml", "xml"])
def test_a_matrix_of_opencv_alone_says_that_it_has_no_lens(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"calibration.{suffix}"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 752)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.reshape(K, (3, 3)))
    storage.write("distortion_coefs", np.array([RADTAN]).T)
    storage.release()
    found = read_calibration(file)
    assert found.unused == ("distortion_coefs",)
    assert any("without distortion coefficients" in note for note in found.notes)


@pytest.mark.parametrize("data", [ROS, MESSAGE, {"cam0": KALIBR}, EUROC, KALIBR_IMU, NERF])
def test_of_a_usual_file_all_is_read(tmp_path: Path, data: dict[str, Any]) -> None:
    name = "transforms.json" if data is NERF else "sensor.yaml"
    assert read_calibration(write(data, tmp_path, name)).unused == ()
