"""EuRoC's sensor.yaml: the pose T_BS maps points of the sensor into the body."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations import Calibration, read_calibration
from oaisys_core.geometry import project
from oaisys_core.importing.robots import sensors_section

T_BS = np.eye(4)
T_BS[:3, :3] = Rotation.from_euler("xyz", (0.3, -1.2, 0.7)).as_matrix()
T_BS[:3, 3] = (-0.02, -0.06, 0.01)
POSE = {"cols": 4, "rows": 4, "data": T_BS.ravel().tolist()}
RADTAN = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
CAMERA: dict[str, Any] = {
    "sensor_type": "camera",
    "comment": "VI-Sensor cam0 (MT9M034)",
    "T_BS": POSE,
    "rate_hz": 20,
    "resolution": [752, 480],
    "camera_model": "pinhole",
    "intrinsics": [458.654, 457.296, 367.215, 248.375],
    "distortion_model": "radial-tangential",
    "distortion_coefficients": RADTAN,
}
IMU: dict[str, Any] = {
    "sensor_type": "imu",
    "T_BS": POSE,
    "rate_hz": 200,
    "gyroscope_noise_density": 1.6968e-04,
    "gyroscope_random_walk": 1.9393e-05,
    "accelerometer_noise_density": 2.0e-3,
    "accelerometer_random_walk": 3.0e-3,
}


def read(data: dict[str, Any], folder: Path) -> Calibration:
    (folder / "cam0").mkdir(exist_ok=True)
    file = folder / "cam0/sensor.yaml"
    file.write_text("#Default sensor yaml file\n" + yaml.safe_dump(data))
    return read_calibration(file)


def test_a_point_of_the_body_is_where_opencv_projects_it(tmp_path: Path) -> None:
    section = sensors_section(read(CAMERA, tmp_path))
    camera = config_from_mapping({"sensors": section}).sensors.cameras[0]
    assert (camera.name, camera.rate_hz, camera.width_px) == ("cam0", 20.0, 752)
    in_camera = np.array([[0.3, -0.2, 1.5], [-0.5, 0.1, 2.0]])
    in_body = in_camera @ T_BS[:3, :3].T + T_BS[:3, 3]
    link = Rotation.from_quat(camera.mount_quat_xyzw)
    x, y, z = link.inv().apply(in_body - camera.mount_position_m).T
    found = project(np.stack((-y, -z, x), axis=1), camera.intrinsics)
    K = np.array([[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]])
    zero = np.zeros(3)
    pixels, _ = cv2.projectPoints(in_camera, zero, zero, K, np.array(RADTAN))
    assert np.abs(found - pixels.reshape(-1, 2)).max() < 1e-6


def test_an_imu_keeps_its_densities(tmp_path: Path) -> None:
    section = sensors_section(read(IMU, tmp_path))
    imu = config_from_mapping({"sensors": section}).sensors.imus[0]
    assert imu.gyroscope_random_walk == 1.9393e-05
    assert imu.accelerometer_noise_density == 2.0e-3
    assert imu.rate_hz == 200
    np.testing.assert_allclose(imu.mount_position_m, T_BS[:3, 3])
    turn = Rotation.from_quat(imu.mount_quat_xyzw).as_matrix()
    np.testing.assert_allclose(turn, T_BS[:3, :3], atol=1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (CAMERA | {"camera_model": "omni"}, "'omni'"),
        (CAMERA | {"distortion_model": "fov"}, "'fov'"),
        (CAMERA | {"T_BS": [1, 2]}, "4 x 4 numbers"),
        (CAMERA | {"sensor_type": "vicon"}, "'vicon'.*camera or imu"),
        ({key: value for key, value in IMU.items() if "walk" not in key}, "accelerometer_random"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, data: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read(data, tmp_path)
