"""Calibrations of other programs: what we project with them is what OpenCV projects."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.config import config_from_mapping, load_config
from oaisys_core.config.sections.sensing.cameras import CameraConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.calibrations import read_calibration
from oaisys_core.geometry import project

SIZE = 752, 480
K = np.array([[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]])
RADTAN = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
EQUI = [0.0034, 0.0007, -0.0021, 0.0002]
OPTICAL_OF_LINK = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Camera link (x forward, z up) to optical frame (z forward, y down), REP-103."""


def points() -> NDArray[np.float64]:
    """Return points that fill the image."""
    x, y = np.meshgrid(np.linspace(-0.75, 0.75, 9), np.linspace(-0.5, 0.5, 7))
    return np.stack((x.ravel(), y.ravel(), np.ones(x.size)), axis=-1) * 3.0


def expected_px(distortion: list[float], fisheye: bool) -> NDArray[np.float64]:
    zero = np.zeros(3)
    if fisheye:
        pixels, _ = cv2.fisheye.projectPoints(
            points()[:, None], zero, zero, K, np.array(distortion)
        )
    else:
        pixels, _ = cv2.projectPoints(points()[:, None], zero, zero, K, np.array(distortion))
    return np.asarray(pixels).reshape(-1, 2)


def check(file: Path, distortion: list[float], fisheye: bool = False) -> CameraConfig:
    """Fail unless a configuration with the file projects as OpenCV does."""
    camera = {"name": "left", "calibration": {"file": str(file)}}
    config = config_from_mapping({"sensors": {"cameras": [camera]}})
    found = config.sensors.cameras[0]
    assert (found.width_px, found.height_px) == SIZE
    off_px = project(points(), found.intrinsics) - expected_px(distortion, fisheye)
    assert np.abs(off_px).max() < 1e-3
    again = config_from_mapping(json.loads(config.model_dump_json()))
    assert again == config
    return found


def ros(model: str, coefficients: list[float]) -> dict[str, Any]:
    return {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": "narrow_stereo/left",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": coefficients},
    }


def message() -> str:
    """Return a message as `ros2 topic echo --once` prints it."""
    data = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "front_optical_frame"},
        "height": SIZE[1],
        "width": SIZE[0],
        "distortion_model": "plumb_bob",
        "d": [*RADTAN, 0.0],
        "k": K.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": [*K[0].tolist(), 0.0, *K[1].tolist(), 0.0, *K[2].tolist(), 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
    return yaml.safe_dump(data) + "---\n"


@pytest.mark.parametrize(
    ("model", "coefficients", "fisheye"),
    [
        ("plumb_bob", [*RADTAN, 0.01], False),
        ("rational_polynomial", [*RADTAN, 0.01, 0, 0, 0], False),
        ("equidistant", EQUI, True),
    ],
)
def test_camera_info(tmp_path: Path, model: str, coefficients: list[float], fisheye: bool) -> None:
    file = tmp_path / "info.yaml"
    file.write_text(yaml.safe_dump(ros(model, coefficients)))
    check(file, coefficients, fisheye)
    assert read_calibration(file).cameras[0].name == "narrow_stereo_left"


def test_an_echoed_message(tmp_path: Path) -> None:
    file = tmp_path / "info.yaml"
    file.write_text(message())
    check(file, RADTAN)
    assert read_calibration(file).cameras[0].name == "front"


def camchain(**of_cam0: Any) -> dict[str, Any]:
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [458.654, 457.296, 367.215, 248.375],
        "distortion_model": "radtan",
        "distortion_coeffs": RADTAN,
        "resolution": list(SIZE),
        "rostopic": "/cam0/image_raw",
    }
    return {"cam0": camera | of_cam0}


@pytest.mark.parametrize("kind", ["radtan", "equidistant"])
def test_camchain(tmp_path: Path, kind: str) -> None:
    coefficients = RADTAN if kind == "radtan" else EQUI
    file = tmp_path / "camchain.yaml"
    file.write_text(yaml.safe_dump(camchain(distortion_model=kind, distortion_coeffs=coefficients)))
    found = check(file, coefficients, kind == "equidistant")
    assert found.mount_position_m == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(found.mount_quat_xyzw, (0, 0, 0, 1), atol=1e-12)


def test_a_chain_is_mounted_where_it_was_calibrated(tmp_path: Path) -> None:
    """A point of the IMU is in a camera where T_cam_imu, and T_cn_cnm1 after it, put it."""
    T_cam0_imu, T_cam1_cam0 = np.eye(4), np.eye(4)
    T_cam0_imu[:3, :3] = Rotation.from_euler("xyz", (0.3, -1.2, 0.7)).as_matrix()
    T_cam0_imu[:3, 3] = (0.05, -0.02, 0.11)
    T_cam1_cam0[:3, :3] = Rotation.from_euler("xyz", (0.01, 0.02, -0.03)).as_matrix()
    T_cam1_cam0[:3, 3] = (-0.11, 0.001, 0.0005)
    data = camchain(T_cam_imu=T_cam0_imu.tolist())
    data["cam1"] = camchain()["cam0"] | {"T_cn_cnm1": T_cam1_cam0.tolist()}
    file = tmp_path / "camchain.yaml"
    file.write_text(yaml.safe_dump(data))
    point_imu = np.array([0.4, 2.0, -1.5, 1.0])
    for name, T_cam_imu in (("cam0", T_cam0_imu), ("cam1", T_cam1_cam0 @ T_cam0_imu)):
        camera = {"name": name, "calibration": {"file": str(file), "camera": name}}
        config = config_from_mapping({"sensors": {"cameras": [camera]}}).sensors.cameras[0]
        link = Rotation.from_quat(config.mount_quat_xyzw)
        in_link = link.inv().apply(point_imu[:3] - config.mount_position_m)
        expected = (T_cam_imu @ point_imu)[:3]
        np.testing.assert_allclose(OPTICAL_OF_LINK.apply(in_link), expected, atol=1e-9)
    with pytest.raises(ConfigError, match="one of cam0, cam1"):
        config_from_mapping({"sensors": {"cameras": [{"calibration": {"file": str(file)}}]}})


def test_a_camera_whose_number_is_too_long_is_no_camera(tmp_path: Path) -> None:
    file = tmp_path / "camchain.yaml"
    file.write_text(yaml.safe_dump({f"cam{'9' * 5000}": camchain()["cam0"]}))
    with pytest.raises(InvalidInputError, match="Kalibr's camchain"):
        read_calibration(file)


def test_noise_of_an_imu(tmp_path: Path) -> None:
    noise = {
        "accelerometer_noise_density": 2.0e-3,
        "accelerometer_random_walk": 3.0e-3,
        "gyroscope_noise_density": 1.6968e-04,
        "gyroscope_random_walk": 1.9393e-05,
    }
    file = tmp_path / "imu.yaml"
    file.write_text(yaml.safe_dump({**noise, "rostopic": "/imu0", "update_rate": 200.0}))
    (imu,) = read_calibration(file).imus
    assert imu == {"name": "imu", "rate_hz": 200.0, **noise}
    config_from_mapping({"sensors": {"imus": [imu]}})


@pytest.mark.parametrize("suffix", ["yaml", "yml", "json", "xml"])
@pytest.mark.parametrize("fisheye", [False, True])
def test_files_of_opencv(tmp_path: Path, suffix: str, fisheye: bool) -> None:
    coefficients = EQUI if fisheye else [*RADTAN, 0.01]
    file = tmp_path / f"calibration.{suffix}"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("fisheye_model", int(fisheye))
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([coefficients]).T)
    storage.release()
    check(file, coefficients, fisheye)


MATRICES = {
    "skew": (0, 1, 25.0),
    "columns by rows": None,
    "a scale": (2, 2, 2.0),
    "perspective": (2, 0, 1e-3),
}


@pytest.mark.parametrize("what", MATRICES)
@pytest.mark.parametrize("name", ["camera_matrix", "M1"])
def test_a_matrix_that_is_none_of_a_pinhole_is_refused(
    tmp_path: Path, what: str, name: str
) -> None:
    matrix, change = K.astype(float), MATRICES[what]
    if change is None:
        matrix = np.ascontiguousarray(matrix.T)
    else:
        matrix[change[:2]] = change[2]
    file = tmp_path / "calibration.yml"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_size", np.array(SIZE, float))
    storage.write(name, matrix)
    storage.release()
    with pytest.raises(InvalidInputError, match="fx, 0, cx, 0, fy, cy, 0, 0, 1"):
        read_calibration(file)


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        ('<!DOCTYPE x [<!ENTITY a "x">]>\n', "Attribute name should be followed by"),
        ("", "nelems == "),
    ],
)
def test_a_file_that_opencv_cannot_read_is_refused_in_its_words(
    tmp_path: Path, head: str, reason: str
) -> None:
    """OpenCV's constructor fails with an error of Python's inside."""
    matrix = (
        '<camera_matrix type_id="opencv-matrix"><rows>300000000</rows><cols>3</cols><dt>d</dt>'
        "<data>1</data></camera_matrix>"
    )
    file = tmp_path / "calibration.xml"
    storage = f"<opencv_storage>{matrix}</opencv_storage>"
    file.write_text(f'<?xml version="1.0"?>\n{head}{storage}')
    with pytest.raises(InvalidInputError, match=f"one that it can read .*{reason}") as error:
        read_calibration(file)
    assert "<class" not in str(error.value)
    assert ".cpp" not in str(error.value)


def test_the_mirror_model_of_opencv_is_refused(tmp_path: Path) -> None:
    """``cv::omnidir`` writes the same names, and xi, without which the others mean nothing."""
    file = tmp_path / "omnidir.yml"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([RADTAN]))
    storage.write("xi", np.array([[1.2]]))
    storage.release()
    with pytest.raises(InvalidInputError, match=r"calibration\.xi.*omnidir"):
        read_calibration(file)


def test_a_file_without_a_size_needs_it_beside(tmp_path: Path) -> None:
    file = tmp_path / "intrinsics.yml"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("M1", K)
    storage.write("D1", np.array([RADTAN]))
    storage.release()
    camera: dict[str, Any] = {"calibration": {"file": str(file)}}
    with pytest.raises(ConfigError, match="no image size, expected width_px and height_px"):
        config_from_mapping({"sensors": {"cameras": [camera]}})
    sized = camera | {"width_px": SIZE[0], "height_px": SIZE[1]}
    config = config_from_mapping({"sensors": {"cameras": [sized]}})
    assert config.sensors.cameras[0].cx_px == K[0, 2]


COLMAP = {
    "SIMPLE_PINHOLE": (0, [458.0, 367.715, 248.875], []),
    "PINHOLE": (1, [458.654, 457.296, 367.715, 248.875], []),
    "SIMPLE_RADIAL": (2, [458.0, 367.715, 248.875, -0.2], [-0.2, 0, 0, 0]),
    "RADIAL": (3, [458.0, 367.715, 248.875, -0.2, 0.03], [-0.2, 0.03, 0, 0]),
    "OPENCV": (4, [458.654, 457.296, 367.715, 248.875, *RADTAN], RADTAN),
    "OPENCV_FISHEYE": (5, [458.654, 457.296, 367.715, 248.875, *EQUI], EQUI),
    "SIMPLE_RADIAL_FISHEYE": (8, [458.0, 367.715, 248.875, 0.01], [0.01, 0, 0, 0]),
    "RADIAL_FISHEYE": (9, [458.0, 367.715, 248.875, 0.01, 0.002], [0.01, 0.002, 0, 0]),
}


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("model", COLMAP)
def test_cameras_of_colmap(tmp_path: Path, model: str, binary: bool) -> None:
    """The centre of COLMAP's first pixel is (0.5, 0.5)."""
    number, values, coefficients = COLMAP[model]
    if binary:
        file = tmp_path / "cameras.bin"
        head = struct.pack("<QiiQQ", 1, 7, number, *SIZE)
        file.write_bytes(head + struct.pack(f"<{len(values)}d", *values))
    else:
        file = tmp_path / "cameras.txt"
        numbers = " ".join(map(repr, values))
        file.write_text(f"# Camera list\n7 {model} {SIZE[0]} {SIZE[1]} {numbers}\n")
    (camera,) = read_calibration(file).cameras
    focal = values[:2] if len(values) in (4, 8) and model.startswith(("PIN", "OPENCV")) else None
    assert camera.focal_px == (tuple(focal) if focal else (458.0, 458.0))
    assert camera.centre_px == (367.215, 248.375)
    found = camera.fisheye if "FISHEYE" in model else camera.distortion
    assert found is not None
    assert list(found.values())[: len(coefficients)] == coefficients
    assert camera.name == "camera7"


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_transforms_of_nerfstudio(tmp_path: Path, model: str) -> None:
    names = ("k1", "k2", "p1", "p2") if model == "OPENCV" else ("k1", "k2", "k3", "k4")
    values = RADTAN if model == "OPENCV" else EQUI
    lens = {"fl_x": 458.654, "fl_y": 457.296, "cx": 367.715, "cy": 248.875}
    data = {"camera_model": model, "w": SIZE[0], "h": SIZE[1], **lens}
    data |= dict(zip(names, values, strict=True)) | {"frames": [{"file_path": "a.png"}] * 2}
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps(data))
    check(file, values, model == "OPENCV_FISHEYE")


def test_a_field_of_view_of_nerf(tmp_path: Path) -> None:
    """The image is 2 tan(angle / 2) focal lengths wide, its middle between pixels 3 and 4."""
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"w": 8, "h": 6, "camera_angle_x": np.pi / 2, "frames": []}))
    (camera,) = read_calibration(file).cameras
    assert camera.focal_px == pytest.approx((4.0, 4.0))
    assert camera.centre_px == (3.5, 2.5)


LACKED = {
    "omni": camchain(camera_model="omni"),
    "double sphere": camchain(camera_model="ds"),
    "fov": camchain(distortion_model="fov"),
    "k4 of a rational model": ros("rational_polynomial", [*RADTAN, 0, 0.1, 0, 0]),
    "s1 of a thin prism model": ros("thin_prism", RADTAN)
    | {"distortion_model": "plumb_bob", "distortion_coefficients": [0] * 8 + [0.1, 0, 0, 0]},
    "thirdorder": ros("thirdorder", RADTAN),
    "resolution": camchain(resolution=[752.5, 480]),
    "intrinsics": camchain(intrinsics=[458, 457, 367]),
    "nan": camchain(intrinsics=[458, 457, 367, float("nan")]),
    "T_cam_imu": camchain(T_cam_imu=(2 * np.eye(4)).tolist()),
    "ROS's camera_info": {"some": "thing"},
}


@pytest.mark.parametrize("what", LACKED)
def test_what_we_lack_or_cannot_be_is_refused_by_name(tmp_path: Path, what: str) -> None:
    file = tmp_path / "calibration.yaml"
    file.write_text(yaml.safe_dump(LACKED[what]))
    word = {"double sphere": "ds", "thirdorder": "thirdorder"}.get(what, what)
    with pytest.raises(InvalidInputError, match=word):
        read_calibration(file)


@pytest.mark.parametrize("model", ["FOV", "THIN_PRISM_FISHEYE", "DIVISION"])
def test_models_of_colmap_that_we_lack_are_refused_by_name(tmp_path: Path, model: str) -> None:
    file = tmp_path / "cameras.txt"
    file.write_text(f"1 {model} 752 480 458 457 367 248 0.9\n")
    with pytest.raises(InvalidInputError, match=f"line 1: received '{model}'"):
        read_calibration(file)


def test_values_stand_in_one_place(tmp_path: Path) -> None:
    (tmp_path / "info.yaml").write_text(message())
    world = tmp_path / "world.yaml"
    camera = "{calibration: {file: info.yaml}, fx_px: 400}"
    world.write_text(f"sensors: {{cameras: [{camera}]}}\n")
    with pytest.raises(ConfigError, match="fx_px is given beside the calibration"):
        load_config(world)
    world.write_text(world.read_text().replace("fx_px: 400", "mount_position_m: [0.1, 0, 0.3]"))
    assert load_config(world).sensors.cameras[0].mount_position_m == (0.1, 0, 0.3)


def test_a_cut_cameras_bin_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cameras.bin"
    file.write_bytes(struct.pack("<QiiQQ", 2, 1, 1, *SIZE) + struct.pack("<3d", 1, 2, 3))
    with pytest.raises(InvalidInputError, match=r"a whole cameras\.bin"):
        read_calibration(file)


def test_a_fisheye_of_instant_ngp(tmp_path: Path) -> None:
    """It has no camera_model; read as radial distortion it would be wrong without a word."""
    path = tmp_path / "transforms.json"
    optics = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2] + 0.5, "cy": K[1, 2] + 0.5}
    lens = dict(zip(("k1", "k2", "k3", "k4"), EQUI, strict=True))
    size = {"w": SIZE[0], "h": SIZE[1]}
    path.write_text(json.dumps({"is_fisheye": True, **optics, **lens, **size}))
    check(path, EQUI, fisheye=True)


def test_a_second_imu_is_where_its_calibration_says(tmp_path: Path) -> None:
    noise = {
        f"{sensor}_{kind}": 1e-3
        for sensor in ("accelerometer", "gyroscope")
        for kind in ("noise_density", "random_walk")
    }
    T_i_b = np.eye(4)
    turn = Rotation.from_euler("xyz", (10, 20, 30), degrees=True)
    T_i_b[:3, :3], T_i_b[:3, 3] = turn.as_matrix(), (0.1, 0.2, 0.3)
    path = tmp_path / "imu.yaml"
    path.write_text(yaml.safe_dump({"imu0": noise, "imu1": {**noise, "T_i_b": T_i_b.tolist()}}))
    _, second = read_calibration(path).imus
    np.testing.assert_allclose(
        second["mount_position_m"], -turn.inv().apply((0.1, 0.2, 0.3)), atol=1e-12
    )
    np.testing.assert_allclose(second["mount_quat_xyzw"], turn.inv().as_quat(), atol=1e-12)


def test_a_chain_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    moved = np.eye(4)
    moved[0, 3] = -0.1
    same = np.eye(4).tolist()
    camera = {
        "camera_model": "pinhole",
        "intrinsics": [400.0, 400.0, 320.0, 240.0],
        "distortion_model": "none",
        "resolution": [640, 480],
        "T_cam_imu": same,
    }
    path = tmp_path / "camchain.yaml"
    chain = {"cam0": camera, "cam1": {**camera, "T_cn_cnm1": moved.tolist()}}
    path.write_text(yaml.safe_dump(chain))
    with pytest.raises(InvalidInputError, match=r"cam1\.T_cam_imu.*what T_cn_cnm1 gives"):
        read_calibration(path)


def test_a_longer_cameras_bin_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cameras.bin"
    file.write_bytes(struct.pack("<QiiQQ", 1, 1, 0, *SIZE) + struct.pack("<4d", 1, 2, 3, 4))
    with pytest.raises(InvalidInputError, match="received '64 bytes', expected 56 for 1 cameras"):
        read_calibration(file)


DEEP = {
    "json": '{"opencv-matrix": ' + "[" * 100_000 + "]" * 100_000 + "}",
    "xml": "<opencv_storage>" + "<a>" * 100_000 + "</a>" * 100_000 + "</opencv_storage>",
    "yaml": "%YAML:1.0\n---\na: " + "[" * 100_000 + "]" * 100_000 + "\n",
    "yaml in lines": "%YAML:1.0\n---\n" + "".join(f"{' ' * n}a:\n" for n in range(2000)),
}


@pytest.mark.parametrize("kind", DEEP)
def test_a_deep_file_is_refused_before_opencv_reads_it(tmp_path: Path, kind: str) -> None:
    """Its parsers ended the process by SIGSEGV."""
    file = tmp_path / "calibration.yaml"
    file.write_text(DEEP[kind])
    with pytest.raises(InvalidInputError, match="at most 64 levels"):
        read_calibration(file)


@pytest.mark.parametrize("angle", [0.0, -1.0, 3.2])
def test_an_angle_of_view_is_between_0_and_a_half_turn(angle: float, tmp_path: Path) -> None:
    file = tmp_path / "transforms.json"
    file.write_text(json.dumps({"w": 8, "h": 6, "camera_angle_x": angle, "frames": []}))
    with pytest.raises(InvalidInputError, match="camera_angle_x"):
        read_calibration(file)
