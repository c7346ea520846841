"""Poses of cameras as KITTI, COLMAP and nerfstudio write them, against evo, pycolmap and SciPy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from evo.tools import file_interface
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, PoseTable, of_rig, read_pose_table
from oaisys_core.world.modules.sensors import SensorsModule

COUNT = 3
TURNS = Rotation.from_euler("zyx", [[10, 20, 30], [-100, 5, 170], [80, -60, 1]], degrees=True)
PLACES_M = np.array([[0.5, -1.25, 2.0], [3.0, 4.0, -5.0], [100.125, 0.0, 1e-3]])
SIDE = {
    "name": "side",
    "mount_position_m": [0.3, -0.2, 1.1],
    "mount_quat_xyzw": [0.5, -0.5, 0.1, 0.7],
}


def matrices() -> NDArray[np.float64]:
    """Return (3, 4, 4) poses by SciPy alone."""
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = TURNS.as_matrix(), PLACES_M
    return T


def as_matrices(table: PoseTable) -> NDArray[np.float64]:
    """Return the (N, 4, 4) poses of a table by SciPy alone."""
    T = np.tile(np.eye(4), (len(table.places), 1, 1))
    T[:, :3, :3] = Rotation.from_quat(table.quats_xyzw).as_matrix()
    T[:, :3, 3] = table.positions_m
    return T


def write_kitti(path: Path) -> None:
    """Write poses as KITTI's benchmark does."""
    rows = (" ".join(f"{value:.17e}" for value in T[:3].ravel()) for T in matrices())
    path.write_text("\n".join(rows))


def colmap_lines() -> list[str]:
    """Return images.txt with our poses as those of cameras in the world."""
    lines = ["# Image list with two lines of data per image:", "#   IMAGE_ID, QW, ...", ""]
    for index, T_camera_world in enumerate(np.linalg.inv(matrices())):
        x, y, z, w = Rotation.from_matrix(T_camera_world[:3, :3]).as_quat()
        numbers = (w, x, y, z, *T_camera_world[:3, 3])
        lines.append(f"{index + 1} {' '.join(map(repr, map(float, numbers)))} 1 a b{index}.png")
        lines.append(["12.5 7.25 -1 100 200 3", "", "1e2 -3 17"][index])
    return lines


def test_kitti_is_read_as_evo_reads_it_and_stands_upright(tmp_path: Path) -> None:
    path = tmp_path / "00.txt"
    write_kitti(path)
    table = read_pose_table(path)
    assert table.of_camera
    assert table.times_s is None
    # The first camera's z axis is forward, its y axis down: map's x and -z.
    upright = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    theirs = np.array(file_interface.read_kitti_poses_file(str(path)).poses_se3)
    assert as_matrices(table) == pytest.approx(upright @ theirs, abs=1e-9)


def read_by_pycolmap(model: Path) -> pycolmap.Reconstruction:
    """Write the poses as a model of text files, and return what pycolmap reads of it."""
    model.mkdir()
    (model / "cameras.txt").write_text("1 SIMPLE_PINHOLE 640 480 500 320 240\n")
    (model / "images.txt").write_text("\n".join(colmap_lines()).replace("a b", "ab") + "\n")
    (model / "points3D.txt").write_text("")
    theirs = pycolmap.Reconstruction()
    theirs.read_text(str(model))
    return theirs


@pytest.mark.parametrize("name", ["images.txt", "model.txt"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_colmap_is_read_as_pycolmap_reads_it(tmp_path: Path, name: str, end: str) -> None:
    path = tmp_path / name
    path.write_bytes(("\ufeff" + end.join(colmap_lines())).encode())
    theirs = read_by_pycolmap(tmp_path / "model")
    inverse = [theirs.images[index + 1].cam_from_world().inverse() for index in range(COUNT)]
    ours = as_matrices(read_pose_table(path))
    assert ours[:, :3] == pytest.approx(np.array([each.matrix() for each in inverse]), abs=1e-9)
    assert ours == pytest.approx(matrices(), abs=1e-9)


def test_the_binary_model_of_colmap_has_the_same_poses(tmp_path: Path) -> None:
    model = tmp_path / "model"
    read_by_pycolmap(model).write_binary(str(model))
    path = model / "images.bin"
    assert as_matrices(read_pose_table(path)) == pytest.approx(matrices(), abs=1e-9)
    for damaged in (path.read_bytes()[:-9], path.read_bytes() + b"\0", b"\xff" * 8):
        path.write_bytes(damaged)
        with pytest.raises(InvalidInputError, match=r"images\.bin"):
            read_pose_table(path)


@pytest.mark.parametrize("rows", [3, 4])
def test_transforms_are_cameras_of_opengl_in_the_world(tmp_path: Path, rows: int) -> None:
    # OpenGL's camera looks along -z with y up: its columns are right, up, back.
    frames = []
    for T in matrices():
        right, down, forward = T[:3, :3].T
        opengl = np.eye(4)
        opengl[:3] = np.column_stack((right, -down, -forward, T[:3, 3]))
        frames.append({"file_path": "a.png", "transform_matrix": opengl[:rows].tolist()})
    path = tmp_path / "transforms.json"
    path.write_text("\ufeff" + json.dumps({"camera_angle_x": 1.0, "frames": frames}))
    table = read_pose_table(path)
    assert table.of_camera
    assert as_matrices(table) == pytest.approx(matrices(), abs=1e-9)


def test_a_camera_stands_where_the_file_says_wherever_it_is_mounted(tmp_path: Path) -> None:
    path = tmp_path / "00.txt"
    write_kitti(path)
    config = SimulationConfig.model_validate({"sensors": {"cameras": [{"name": "front"}, SIDE]}})
    sensors = SensorsModule(config.sensors).sensors
    table = read_pose_table(path)
    for camera, sensor in ((None, sensors[0]), ("front", sensors[0]), ("side", sensors[1])):
        T_map_base = as_matrices(of_rig(table, sensors, camera))
        assert T_map_base @ sensor.T_base_camera == pytest.approx(as_matrices(table), abs=1e-9)
    with pytest.raises(InvalidInputError, match="camera: received 'sid', expected one of front"):
        of_rig(table, sensors, "sid")


def test_a_trajectory_may_be_that_of_a_camera_too(tmp_path: Path) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text("# timestamp tx ty tz qx qy qz qw\n0 1 2 3 0 0 0 1\n1 1 2 4 0 0 0 1\n")
    table = read_pose_table(path)
    assert of_rig(table) is table
    config = SimulationConfig.model_validate({"sensors": {"cameras": [{"name": "front"}]}})
    sensors = SensorsModule(config.sensors).sensors
    moved = as_matrices(of_rig(table, sensors, "front"))
    assert moved @ sensors[0].T_base_camera == pytest.approx(as_matrices(table), abs=1e-12)


IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"
IMAGE = "1 1 0 0 0 0 0 0 1 a.png"
MATRIX = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def transforms(matrix: object) -> str:
    """Return a transforms.json with one good frame and another."""
    return json.dumps({"frames": [{"transform_matrix": MATRIX}, {"transform_matrix": matrix}]})


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.txt", f"{IDENTITY}\n1 0 0 0 0 1 0 0 0 0 1\n", r"a\.txt:2: .*12 numbers.*not 11"),
        (
            "a.txt",
            f"{IDENTITY}\n1 0 0 0.12345678901234567x 0 1 0 0 0 0 1 0",
            r"a\.txt:2: received '0\.12345678901234567x', .*the column row 1, 4",
        ),
        ("a.txt", f"{IDENTITY}\n-1 0 0 0 0 1 0 0 0 0 1 0", r"a\.txt:2: .*a rotation"),
        ("a.txt", f"{IDENTITY}\n1e308 1e308 0 0 0 -1 0 0 0 0 -1 3", r"a\.txt:2: .*a rotation"),
        ("a.txt", f"{IDENTITY}\n2 0 0 0 0 2 0 0 0 0 2 0", r"a\.txt:2: .*not scaled"),
        ("a.txt", f"{IDENTITY}\n1 0 0 nan 0 1 0 0 0 0 1 0", r"a\.txt:2: .*finite"),
        ("images.txt", f"{IMAGE}\n{IMAGE}\n", r"images\.txt:2: .*the points of a\.png"),
        ("images.txt", "1 1 0 0 0 0 0 0 1\n", r"images\.txt:1: .*IMAGE_ID, QW"),
        ("images.txt", f"{IMAGE}\n\n2 1 0 0 q 0 0 0 1 b\n", r"images\.txt:3: .*'q'.*column QZ"),
        ("images.txt", f"{IMAGE}\n\n2 2 0 0 0 0 0 0 1 b\n", r"images\.txt:3\.orientation.*unit"),
        ("images.txt", "# nothing\n", "at least one image"),
        ("a.json", transforms([[1, 0], [0, 1]]), r"a\.json: frames\.1\.transform_matrix"),
        ("a.json", transforms([["1", 0, 0, 0], *MATRIX[1:]]), r"frames\.1\.transform_matrix"),
        ("a.json", transforms(None), r"frames\.1\.transform_matrix: received None"),
        ("a.json", transforms([[3, 0, 0, 0], *MATRIX[1:]]), r"frames\.1.*a rotation"),
        ("a.json", '{"frames": []}', r"frames: .*at least one frame"),
        ("a.json", '{"poses": []}', "other JSON"),
        ("a.json", '{"frames": [', "a readable file"),
        ("a.csv", "0,1,2,3,0,0,0,1\n", r"a\.csv:1: .*a header in the first row"),
        ("a.csv", "t,x,y\n0,1,2\n", r"a\.csv:1: .*qw is not there"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, name: str, text: str, told: str
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=told), np.errstate(over="raise", invalid="raise"):
        read_pose_table(path)


def test_keys_of_bags_are_refused_for_other_files(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(IDENTITY)
    with pytest.raises(InvalidInputError, match=r"topic: received '/odom', .*a\.txt is no bag"):
        read_pose_table(path, PoseSelection(topic="/odom"))
