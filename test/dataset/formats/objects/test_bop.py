"""BOP, read by a reader written from its format page alone, against OpenCV, trimesh and PIL."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from object_worlds import object_config, true_meshes
from PIL import Image
from scipy.spatial import ConvexHull
from small_datasets import SMALL, render_dataset

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_dataset import Dataset, open_dataset
from oaisys_dataset.formats.base import ExportOptions
from oaisys_dataset.formats.export import export_dataset

MM = 1000.0


@pytest.fixture(scope="module")
def exported(known: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("bop") / "out"
    counts = export_dataset(known, "bop", target)
    assert counts["frames"] == len(known)
    return target


def read_json(path: Path) -> Any:
    return json.loads(path.read_text())


def pixels(path: Path) -> NDArray[Any]:
    return np.asarray(Image.open(path))


def scene_folders(exported: Path) -> list[Path]:
    return sorted(path.parent for path in exported.glob("*/*/scene_gt.json"))


def test_cameras_colour_and_depth_are_those_of_the_frames(known: Dataset, exported: Path) -> None:
    scenes = read_json(exported / "scenes.json")
    assert [folder.parent.name for folder in scene_folders(exported)] == ["train", "val"]
    for folder in scene_folders(exported):
        assert scenes[str(int(folder.name))]["split"] == folder.parent.name
        cameras = read_json(folder / "scene_camera.json")
        samples = list(known.split(folder.parent.name))
        assert list(cameras) == [str(sample.record.view) for sample in samples]
        for camera, sample in zip(cameras.values(), samples, strict=True):
            np.testing.assert_array_equal(np.reshape(camera["cam_K"], (3, 3)), sample.K)
            T = np.eye(4)
            T[:3, :3] = np.reshape(camera["cam_R_w2c"], (3, 3))
            T[:3, 3] = np.array(camera["cam_t_w2c"]) / MM
            np.testing.assert_allclose(T @ sample.T_map_camera, np.eye(4), atol=1e-9)
            name = f"{sample.record.view:06d}.png"
            assert np.array_equal(pixels(folder / "rgb" / name), sample.arrays["rgb"])
            depth = pixels(folder / "depth" / name)
            assert depth.dtype == np.uint16
            depth_m = sample.arrays["depth"]
            fits = depth_m < 65.5
            off_mm = np.abs(depth * camera["depth_scale"] - MM * depth_m)
            assert off_mm[fits].max() <= 0.51
            assert (depth[~np.isfinite(depth_m)] == 0).all()


def test_models_at_their_poses_are_the_true_meshes_and_project_onto_the_masks(
    known: Dataset, exported: Path
) -> None:
    objects, truth, hidden = read_json(exported / "objects.json"), true_meshes(), 0
    infos = read_json(exported / "models/models_info.json")
    for folder in scene_folders(exported):
        cameras, poses = (
            read_json(folder / name) for name in ("scene_camera.json", "scene_gt.json")
        )
        gt_infos = read_json(folder / "scene_gt_info.json")
        for image, listed in poses.items():
            K = np.reshape(cameras[image]["cam_K"], (3, 3))
            R_w2c = np.reshape(cameras[image]["cam_R_w2c"], (3, 3))
            assert len(listed) == len(gt_infos[image]) > 0
            for index, (pose, info) in enumerate(zip(listed, gt_infos[image], strict=True)):
                name = str(pose["obj_id"])
                model = trimesh.load(exported / f"models/obj_{pose['obj_id']:06d}.ply")
                model_info = infos[name]
                low = np.array([model_info[f"min_{axis}"] for axis in "xyz"])
                size = np.array([model_info[f"size_{axis}"] for axis in "xyz"])
                np.testing.assert_allclose(model.bounds, [low, low + size], atol=0.6)
                np.testing.assert_allclose(low + size / 2, 0, atol=1e-6)
                R = np.reshape(pose["cam_R_m2c"], (3, 3))
                t = np.array(pose["cam_t_m2c"])
                in_map = (model.vertices @ R.T + t - cameras[image]["cam_t_w2c"]) @ R_w2c / MM
                wanted = truth[objects[name]["label"]]
                box = in_map.min(axis=0), in_map.max(axis=0)
                np.testing.assert_allclose(box, wanted.bounds, atol=4e-3)
                diameter = np.linalg.norm(model.vertices - model.vertices[:1], axis=1).max()
                assert model_info["diameter"] >= diameter - 0.6

                turn, _ = cv2.Rodrigues(R)
                uv, _ = cv2.projectPoints(model.vertices, turn, t, K, np.zeros(5))
                number = f"{int(image):06d}_{index:06d}.png"
                mask, visible = (pixels(folder / kind / number) for kind in ("mask", "mask_visib"))
                assert set(np.unique(mask)) <= {0, 255}
                assert (mask[visible > 0] == 255).all()
                judge_mask(mask > 0, uv[:, 0], info)
                shown = int((visible > 0).sum())
                assert info["px_count_visib"] == shown
                assert info["visib_fract"] == pytest.approx(shown / info["px_count_all"])
                v, u = np.nonzero(visible)
                box_visib = [u.min(), v.min(), np.ptp(u) + 1, np.ptp(v) + 1]
                assert info["bbox_visib"] == box_visib
                depth = pixels(folder / "depth" / f"{int(image):06d}.png")
                assert info["px_count_valid"] == ((mask > 0) & (depth > 0)).sum()
                hidden += shown < (mask > 0).sum()
    assert hidden
    assert {each["label"] for each in objects.values()} == set(truth)
    # The same shapes are in both worlds.
    assert len(objects) == 3


def judge_mask(mask: NDArray[np.bool_], uv: NDArray[np.float64], info: dict[str, Any]) -> None:
    """Compare a mask with the convex hull of projected vertices."""
    hull = ConvexHull(uv).equations
    v, u = np.indices(mask.shape)
    grid = np.stack((u.ravel(), v.ravel()), axis=-1)
    inside = (grid @ hull[:, :2].T + hull[:, 2] <= 0).all(axis=1).reshape(mask.shape)
    assert (inside != mask).sum() <= 4 + 0.03 * inside.sum()
    left, top, width, height = info["bbox_obj"]
    np.testing.assert_allclose([left, top], np.ceil(uv.min(axis=0)), atol=1.5)
    np.testing.assert_allclose([left + width, top + height], uv.max(axis=0) + 1, atol=1.5)


def test_objects_of_random_sizes_have_models_of_their_own(tmp_path: Path) -> None:
    render_dataset(tmp_path / "set", {0: "train"}, 2, SMALL)
    dataset = open_dataset(tmp_path / "set")
    export_dataset(dataset, "bop", tmp_path / "out")
    rows = [row for record in dataset.records for row in dataset.objects(record)]
    infos = read_json(tmp_path / "out/models/models_info.json")
    assert len(infos) == len({row.instance_id for row in rows})
    for row in rows:
        assert row.diameter_m * MM in [pytest.approx(info["diameter"]) for info in infos.values()]


def test_depth_scale_reaches_farther_and_models_can_be_left_out(
    known: Dataset, tmp_path: Path
) -> None:
    options = ExportOptions(settings={"depth_scale": "2.5", "models": "no"})
    counts = export_dataset(known, "bop", tmp_path / "out", options)
    (folder, _) = scene_folders(tmp_path / "out")
    camera = read_json(folder / "scene_camera.json")["0"]
    depth_m = known[0].arrays["depth"]
    depth = pixels(folder / "depth/000000.png") * camera["depth_scale"] / MM
    assert np.abs(depth - depth_m)[np.isfinite(depth_m) & (depth > 0)].max() < 2e-3
    assert not list((tmp_path / "out").rglob("*.ply"))
    assert not (folder / "mask").exists()
    assert counts["models"] == 3


def test_what_bop_cannot_describe_is_refused(known: Dataset, tmp_path: Path) -> None:
    for settings in ({"depth_scale": "0"}, {"models": "maybe"}):
        with pytest.raises(InvalidInputError, match=f"settings.{next(iter(settings))}"):
            export_dataset(known, "bop", tmp_path / "out", ExportOptions(settings=settings))
    lens = {"width_px": 64, "height_px": 48, "distortion": {"k1": -0.2}}
    lens["modalities"] = ["rgb", "depth", "instance"]
    config = object_config(tmp_path, {"cameras": [lens]})
    render_dataset(tmp_path / "lens", {0: "train"}, 1, config)
    with pytest.raises(InvalidInputError, match="without distortion"):
        export_dataset(open_dataset(tmp_path / "lens"), "bop", tmp_path / "out")


def test_a_world_that_cannot_be_made_again_says_how_to_do_without(
    known: Dataset, tmp_path: Path
) -> None:
    config = object_config(tmp_path)
    render_dataset(tmp_path / "set", {0: "train"}, 1, config)
    (tmp_path / "wedge.ply").unlink()
    with pytest.raises(RenderError, match="--set models=no"):
        export_dataset(open_dataset(tmp_path / "set"), "bop", tmp_path / "out")
