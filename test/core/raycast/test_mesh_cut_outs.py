"""Images and holes of meshes from files: alike in colour, depth, labels and lidar."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from gltf_files import GltfFile, base_color
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.raycast.mesh_textures import interpolate
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.targets import placement_targets
from oaisys_core.render.shading.reflectance import Reflectance
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

EYE_M = 3.0
"""How far the camera is in front of the first card; the second one is a metre behind it."""


def cards(path: Path) -> Path:
    """Two cards of 1 m, one behind the other: the first has a hole, the upper right quarter."""
    rgba = np.full((2, 2, 4), 255, np.uint8)
    rgba[..., :3] = (250, 0, 0)
    # Constant along both axes, so that the border between pixels is sharp enough to count them.
    rgba = rgba.repeat(128, axis=0).repeat(128, axis=1)
    rgba[:128, 128:, 3] = 0
    file = GltfFile()
    clamped = {"sampler": 0}
    front = base_color(baseColorTexture=file.texture(rgba, **clamped)) | {"alphaMode": "MASK"}
    half = np.zeros((256, 256, 3), np.uint8)
    half[:, :128], half[:, 128:] = (0, 250, 0), (0, 0, 250)
    file.square(front)
    file.square(base_color(baseColorTexture=file.texture(half, **clamped)), (0, 0, -1))
    sampler = {"wrapS": 33071, "wrapT": 33071}
    return file.save(path, samplers=[sampler])


def world(path: Path, **more: Any) -> dict[str, Any]:
    label = {"label": "card", "semantic_id": 7}
    card = {"name": "card", "file": str(path), "position_m": (0.0, 0.0, 10.0), **label}
    camera = {"width_px": 64, "height_px": 64, "fx_px": 101.0, "fy_px": 101.0}
    modalities = ["rgb", "albedo", "depth", "semantic_0", "instance"]
    return {
        "backend": "analytic",
        "stage": {"preset": "plane", "extent_m": 20.0, "resolution_px": 17},
        "materials": {"texture_size_px": 16, "mask": {"size_px": 16, "relief": 0}},
        "assets": {"rocks": [], "objects": [card | {"anchor": "origin"}]},
        "sensors": {"cameras": [{"name": "camera", **camera, "modalities": modalities}], **more},
        "render": {"quality": "preview", "denoise": False},
    }


def pose() -> ModuleMetadata:
    """In front of the cards' middle: y is 0 on the first one, 1 on the second."""
    return ModuleMetadata(sensor={"pose": pose_looking_at((0.5, -EYE_M, 10.5), (0.5, 0.0, 10.5))})


def images(path: Path) -> dict[str, NDArray[Any]]:
    simulation = Simulation(config_from_mapping(world(path)))
    simulation.step_batch()
    sample = simulation.step_sample(pose())
    return {frame.modality: frame.data for frame in sample.frames}


def seen_through(shape: tuple[int, int] = (64, 64)) -> tuple[NDArray[Any], NDArray[Any]]:
    """Which pixels' centres see the first card, and which the second one, by similar triangles."""
    column, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    x, z = (column - 31.5) / 101, -(row - 31.5) / 101
    on_first = (np.abs(x * EYE_M) < 0.5) & (np.abs(z * EYE_M) < 0.5)
    on_second = (np.abs(x * (EYE_M + 1)) < 0.5) & (np.abs(z * (EYE_M + 1)) < 0.5)
    hole = (x > 0) & (z > 0)
    first = on_first & ~hole
    return first, on_second & ~first


@pytest.mark.parametrize("merged", [True, False])
def test_depth_labels_and_colours_see_through_holes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, merged: bool
) -> None:
    if not merged:
        monkeypatch.setattr(placement_targets, "MERGED_TRIANGLES", 0)
    found = images(cards(tmp_path / "cards.gltf"))
    first, second = seen_through()
    assert second.sum() > 100
    np.testing.assert_allclose(found["depth"][first], EYE_M, atol=1e-5)
    np.testing.assert_allclose(found["depth"][second], EYE_M + 1, atol=1e-5)
    assert (found["depth"][~first & ~second] > EYE_M + 1.5).all()
    assert ((found["semantic_0"] == 7) == (first | second)).all()
    assert len(np.unique(found["instance"][first | second])) == 1
    column = np.broadcast_to(np.arange(64), (64, 64))
    assert (found["albedo"][first] == (250, 0, 0)).all()
    assert (found["albedo"][second & (column > 33)] == (0, 0, 250)).all()
    assert (found["rgb"][first][:, 1:] == 0).all(), "red in the picture, too"


def test_a_lidar_goes_through_holes_and_returns_the_images_reflectance(tmp_path: Path) -> None:
    path = cards(tmp_path / "cards.gltf")
    simulation = Simulation(config_from_mapping(world(path)))
    simulation.step_batch()
    scene = simulation.scene
    surface = Surface(scene, None)
    directions = np.array([(0.06, 1, 0.06), (-0.06, 1, -0.06), (-0.06, 1, 0.06)])
    lengths = np.linalg.norm(directions, axis=1)
    view = surface.cast(np.array((0.5, -EYE_M, 10.5)), directions / lengths[:, None], 50.0)
    np.testing.assert_allclose(view.depth_m[:, 0] / lengths, (EYE_M + 1, EYE_M, EYE_M), rtol=1e-9)
    found = Reflectance(scene).at(view, np.zeros(3), surface)
    linear_250 = ((250 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(found, linear_250 / 3, rtol=1e-6)


def test_a_hundred_holes_one_behind_the_other_are_passed(tmp_path: Path) -> None:
    file = GltfFile()
    rgba = np.zeros((2, 2, 4), np.uint8)
    hole = base_color(baseColorTexture=file.texture(rgba)) | {"alphaMode": "MASK"}
    for number in range(100):
        file.square(hole, (0, 0, -0.001 * number))
    file.square(base_color(), (0, 0, -1))
    found = images(file.save(tmp_path / "many.gltf"))
    first, second = seen_through()
    assert (found["semantic_0"][~first & ~second] != 7).all()
    np.testing.assert_allclose(found["depth"][32, 32], EYE_M + 1, atol=1e-5)


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
def test_images_go_on_outside_as_opencv_says(wrap: str) -> None:
    import cv2

    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    uv = np.random.default_rng(1).uniform(-2, 3, (500, 2))
    border = {
        "repeat": cv2.BORDER_WRAP,
        "clamp": cv2.BORDER_REPLICATE,
        "mirror": cv2.BORDER_REFLECT,
    }[wrap]
    pad = cv2.copyMakeBorder(image, 25, 25, 35, 35, border).astype(np.float32)
    x = (uv[:, 0] * 7 - 0.5 + 35).astype(np.float32)
    y = ((1 - uv[:, 1]) * 5 - 0.5 + 25).astype(np.float32)
    expected = cv2.remap(pad, x[None], y[None], cv2.INTER_LINEAR)[0]
    values = np.arange(256, dtype=np.float64)
    found = interpolate(image, uv, (wrap, wrap), values)  # type: ignore[arg-type]
    # OpenCV interpolates in steps of 1/32 of a pixel.
    np.testing.assert_allclose(found, expected, atol=255 / 16)
    assert np.abs(found - expected).mean() < 2.5


@pytest.mark.blender
def test_blenders_picture_sees_through_the_same_holes(tmp_path: Path) -> None:
    path = cards(tmp_path / "cards.gltf")
    of_blender = in_blender("files.render_sample", world(path) | {"backend": "blender"}, pose())
    exact = images(path)
    for name in ("depth", "semantic_0", "instance"):
        np.testing.assert_array_equal(of_blender[name], exact[name])
    # Away from edges, where a pixel's area sees one colour.
    first, second = seen_through()
    for mask in (first, second):
        inner = mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
        inner = np.pad(inner, 1) & (np.abs(np.arange(64) - 31.5) > 2)
        one, other = (each["albedo"].astype(int)[inner] for each in (of_blender, exact))
        np.testing.assert_allclose(one, other, atol=3)
        assert of_blender["rgb"][inner].max(axis=1).mean() > 50
