"""pycolmap, OpenCV and Open3D read COLMAP's and nerfstudio's exports and find the same surface."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import open3d
import pycolmap
import pytest
from rendered_datasets import rig_sensors, write_rendered_dataset

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import unproject
from oaisys_core.types import FloatArray
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset
from oaisys_dataset.formats.reconstruction.colmap import ColmapFormat
from oaisys_dataset.formats.reconstruction.nerfstudio import NerfstudioFormat

VIEWS = 4
POINTS = 60
WITHIN_PX = 0.01
SETTINGS = {"points_per_view": f"{POINTS}"}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A world seen by four cameras, two of which distort in different ways."""
    folder = tmp_path_factory.mktemp("rig")
    write_rendered_dataset(folder, {3: "train"}, VIEWS, rig_sensors())
    return open_dataset(folder)


def exported_model(dataset: Dataset, folder: Path, kind: str) -> pycolmap.Reconstruction:
    options = ExportOptions(settings={**SETTINGS, "model": kind})
    counts = ColmapFormat().write(dataset, folder, options)
    assert counts["points"] == POINTS * len(dataset)
    return pycolmap.Reconstruction(folder / "world_000003/sparse/0")


@pytest.mark.parametrize("kind", ["binary", "text"])
def test_pycolmap_reads_poses_and_points_reproject_in_every_camera_model(
    rig: Dataset, tmp_path: Path, kind: str
) -> None:
    model = exported_model(rig, tmp_path, kind)
    names = {camera.model.name for camera in model.cameras.values()}
    assert names == {"PINHOLE", "OPENCV", "FULL_OPENCV"}
    records = {f"{record.sensor}/{record.frame_id}.png": record for record in rig.records}
    assert {image.name for image in model.images.values()} == set(records)
    observed = 0
    for image in model.images.values():
        record = records[image.name]
        T_camera_map = image.cam_from_world().matrix()
        np.testing.assert_allclose(T_camera_map, np.linalg.inv(record.pose)[:3], atol=1e-9)
        file = tmp_path / "world_000003/images" / image.name
        assert file.read_bytes() == rig.files(record)["rgb"]
        for point in image.points2D:
            pixel = image.project_point(model.points3D[point.point3D_id].xyz)
            np.testing.assert_allclose(pixel, point.xy, atol=WITHIN_PX)
            observed += 1
    tracks = sum(point.track.length() for point in model.points3D.values())
    assert tracks == observed > 1.5 * POINTS * len(rig)


def test_points_lie_at_the_depth_of_their_pixel_and_have_its_colour(
    rig: Dataset, tmp_path: Path
) -> None:
    model = exported_model(rig, tmp_path, "binary")
    records = {f"{record.sensor}/{record.frame_id}.png": record for record in rig.records}
    for image in model.images.values():
        sample = rig.sample(records[image.name])
        own = list(image.points2D)[:POINTS]
        pixels = np.array([point.xy for point in own]) - 0.5
        columns, rows = np.rint(pixels).astype(int).T
        np.testing.assert_allclose(pixels, np.column_stack((columns, rows)), atol=1e-12)
        points = [model.points3D[point.point3D_id] for point in own]
        colors = [point.color for point in points]
        assert np.array_equal(colors, sample.arrays["rgb"][rows, columns])
        depth_m = sample.arrays["depth"][rows, columns]
        in_camera_m = unproject(pixels, depth_m, sample.record.camera)
        in_map_m = in_camera_m @ sample.T_map_camera[:3, :3].T + sample.T_map_camera[:3, 3]
        np.testing.assert_allclose([point.xyz for point in points], in_map_m, atol=1e-6)


def test_points_seen_in_other_views_are_on_the_surface_there(rig: Dataset, tmp_path: Path) -> None:
    model = exported_model(rig, tmp_path, "binary")
    records = {f"{record.sensor}/{record.frame_id}.png": record for record in rig.records}
    errors = []
    for image in model.images.values():
        depth_m = rig.sample(records[image.name], ("depth",)).arrays["depth"]
        for point in list(image.points2D)[POINTS:]:
            column, row = np.rint(point.xy - 0.5).astype(int)
            z_m = (image.cam_from_world() * model.points3D[point.point3D_id].xyz)[2]
            errors.append(abs(z_m / depth_m[row, column] - 1))
    assert len(errors) > 0.5 * POINTS * len(rig)
    assert np.median(errors) < 0.02
    assert np.max(errors) < 0.11


@pytest.fixture(scope="module")
def fisheyes(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A world seen by a fisheye."""
    folder = tmp_path_factory.mktemp("fisheyes")
    lens = {"k1": 0.03, "k2": -0.004, "k3": 0.001, "k4": -0.0001}
    camera = {"width_px": 64, "height_px": 48, "fx_px": 30.0, "fy_px": 31.0, "fisheye": lens}
    sensors = {"cameras": [{**camera, "modalities": ["rgb", "depth"]}]}
    write_rendered_dataset(folder, {3: "train"}, VIEWS, sensors)
    return open_dataset(folder)


def test_points_of_a_fisheye_reproject_in_pycolmap(fisheyes: Dataset, tmp_path: Path) -> None:
    model = exported_model(fisheyes, tmp_path, "binary")
    assert {camera.model.name for camera in model.cameras.values()} == {"OPENCV_FISHEYE"}
    observed = 0
    for image in model.images.values():
        for point in image.points2D:
            pixel = image.project_point(model.points3D[point.point3D_id].xyz)
            np.testing.assert_allclose(pixel, point.xy, atol=WITHIN_PX)
            observed += 1
    assert observed > 1.5 * POINTS * len(fisheyes)


def test_formats_without_fisheyes_refuse_them(fisheyes: Dataset, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"no fisheye cameras, which nerfstudio cannot"):
        export_dataset(fisheyes, "nerfstudio", tmp_path / "out")


def test_a_model_of_another_kind_is_refused(rig: Dataset, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"settings\.model"):
        ColmapFormat().write(rig, tmp_path, ExportOptions(settings={"model": "json"}))


def projected(points_m: FloatArray, frame: dict[str, Any], head: dict[str, Any]) -> FloatArray:
    """Project as transforms.json says: OpenGL's axes, OpenCV's lens, pixels from the corner."""
    camera = {**head, **frame}
    T_opengl_map = np.linalg.inv(frame["transform_matrix"])
    T_opencv_map = np.diag((1.0, -1.0, -1.0, 1.0)) @ T_opengl_map
    lens = np.array([camera[name] for name in ("k1", "k2", "p1", "p2", "k3")])
    K = np.array(
        [[camera["fl_x"], 0, camera["cx"]], [0, camera["fl_y"], camera["cy"]], [0, 0, 1.0]]
    )
    turn, _ = cv2.Rodrigues(T_opencv_map[:3, :3])
    pixels, _ = cv2.projectPoints(points_m, turn, T_opencv_map[:3, 3], K, lens)
    return pixels.reshape(-1, 2)


def test_nerfstudio_points_reproject_through_the_stated_convention(
    rig: Dataset, tmp_path: Path
) -> None:
    counts = NerfstudioFormat().write(rig, tmp_path, ExportOptions(settings=SETTINGS))
    assert counts["frames"] == len(rig)
    folder = tmp_path / "world_000003"
    head = json.loads((folder / "transforms.json").read_text())
    cloud = open3d.io.read_point_cloud(str(folder / head["ply_file_path"]))
    points_m = np.asarray(cloud.points)
    assert len(points_m) == counts["points"] == POINTS * len(rig)
    for index, (frame, record) in enumerate(zip(head["frames"], by_camera(rig), strict=True)):
        assert (folder / frame["file_path"]).read_bytes() == rig.files(record)["rgb"]
        drawn = slice(index * POINTS, (index + 1) * POINTS)
        pixels = projected(points_m[drawn], frame, head)
        from_centre_px = (pixels - 0.5) - np.rint(pixels - 0.5)
        assert np.abs(from_centre_px).max() < WITHIN_PX
        columns, rows = np.rint(pixels - 0.5).astype(int).T
        sample = rig.sample(record)
        depth_mm = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        expected_mm = sample.arrays["depth"][rows, columns] * 1000
        expected_mm[expected_mm > 65535] = 0
        np.testing.assert_allclose(depth_mm[rows, columns], expected_mm, atol=0.51)
        colors = np.asarray(cloud.colors)[drawn] * 255
        np.testing.assert_allclose(colors, sample.arrays["rgb"][rows, columns], atol=0.01)


def test_nerfstudio_says_one_camera_once(tmp_path: Path) -> None:
    write_rendered_dataset(tmp_path / "set", {0: "train"}, 2)
    NerfstudioFormat().write(open_dataset(tmp_path / "set"), tmp_path, ExportOptions())
    head = json.loads((tmp_path / "world_000000/transforms.json").read_text())
    assert (head["w"], head["h"], head["cx"], head["cy"]) == (64, 48, 32.0, 24.0)
    assert all("w" not in frame for frame in head["frames"])


def by_camera(dataset: Dataset) -> list[Any]:
    """Return the records camera by camera, as exports order them."""
    sensors = list(dict.fromkeys(record.sensor for record in dataset.records))
    return sorted(dataset.records, key=lambda record: (sensors.index(record.sensor), record.view))
