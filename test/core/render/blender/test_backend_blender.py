"""The Blender backend: agreement with Cycles, colour, and what stays in Blender."""

import sys
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from synthetic_worlds import (
    BOX,
    CENTRED,
    SKEWED,
    SUNNY,
    camera,
    rocky_world,
    with_separate_rocks,
)

from oaisys_core.errors import BackendUnavailableError
from oaisys_core.geometry import pose_looking_at, pose_looking_down, project, transform
from oaisys_core.render import make_backend
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.types import ALBEDO, DEPTH, INSTANCE, RGB, PinholeIntrinsics

pytestmark = pytest.mark.blender

BIG_PIXELS = PinholeIntrinsics(60, 80, 50.0, 33.0, 20.5, 51.0)
"""Upright, and wider pixels than high ones."""


def edges(depth_m: NDArray[Any], ids: NDArray[Any]) -> NDArray[Any]:
    """Whether a pixel lies beside another object or a jump of depth."""
    near, far = minimum_filter(depth_m, 3), maximum_filter(depth_m, 3)
    with np.errstate(invalid="ignore"):
        jump = ~(far - near < 0.15 * near)
    return np.asarray(jump | (minimum_filter(ids, 3) != maximum_filter(ids, 3)))


def test_depth_and_ids_are_those_that_cycles_renders_beside_the_colour() -> None:
    poses = (
        (pose_looking_down(0.3, 0.1, 10.0, 0.4), CENTRED),
        (pose_looking_at((-6, -5, 3), (2, 1, 0)), SKEWED),
        (pose_looking_at((5, -7, 4), (0, 0, 0), (0.3, 0.2, 1)), BIG_PIXELS),
    )
    cameras = [camera(pose, k, (RGB, DEPTH, INSTANCE)) for pose, k in poses]
    for (_, depth, instance), cycles_depth_m, cycles_ids in in_blender(
        "backend.passes", with_separate_rocks(rocky_world()), cameras
    ):
        hit = np.isfinite(depth.data)
        inner = hit & ~edges(depth.data, instance.data)
        assert inner.mean() > 0.2
        assert len(np.unique(instance.data)) > 5
        off = np.abs(depth.data[inner] / cycles_depth_m[inner] - 1)
        assert off.max() < 1e-4
        assert (cycles_ids[inner] == instance.data[inner]).all()
        assert (cycles_ids == instance.data).mean() > 0.999
        assert (cycles_depth_m[~hit] > 1e9).all()


def test_mesh_and_heights_are_those_of_the_scene() -> None:
    scene = replace(rocky_world(), primitives=(BOX,))
    xy_m = np.random.default_rng(1).uniform(-21, 21, (400, 2))
    mesh, height_m = in_blender("backend.surface", scene, xy_m)
    analytic = AnalyticBackend()
    analytic.build(scene, lambda _: None)
    expected = analytic.ground_truth_mesh()
    np.testing.assert_allclose(mesh.vertices_m, expected.vertices_m, atol=1e-5)
    assert (mesh.triangles == expected.triangles).all()
    assert (mesh.semantic_ids == expected.semantic_ids).all()
    assert (mesh.instance_ids == expected.instance_ids).all()
    np.testing.assert_allclose(height_m, analytic.surface_height_m(xy_m), atol=1e-4)


def test_without_bpy_the_backend_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("oaisys_core.render.blender")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(BackendUnavailableError, match="bpy cannot be imported"):
        make_backend("blender")


@pytest.fixture(scope="module")
def life() -> dict[str, Any]:
    found: dict[str, Any] = in_blender("backend.life")
    return found


def test_a_rebuilt_world_leaves_nothing_of_the_old_one(life: dict[str, Any]) -> None:
    assert life["again"] == life["first"] == life["after cancelling"]
    assert life["cancelled"]
    assert life["without rocks"]["objects"] < life["first"]["objects"] - 70


def test_an_unchanged_ground_stays(life: dict[str, Any]) -> None:
    assert life["ground kept"]


@pytest.mark.long
def test_a_picture_does_not_depend_on_the_samples_of_those_before() -> None:
    few, _, few_again, many, _, many_again = in_blender(
        "backend.pictures_by_samples", [2, 600, 2, 300, 600, 300]
    )
    np.testing.assert_array_equal(few_again, few)
    np.testing.assert_array_equal(many_again, many)
    assert (many != few).any()


def test_light_and_exposure_change_the_colour(life: dict[str, Any]) -> None:
    assert life["brighter"].mean() > life["sunny"].mean() + 10
    assert life["night"].mean() < 0.3 * life["sunny"].mean()


@pytest.mark.long
def test_cycles_looks_at_all_that_changed_and_at_nothing_for_a_moved_camera() -> None:
    found = in_blender("backend.moves")
    for name, (marks, image, alone) in found.items():
        difference = np.abs(image.astype(int) - alone)
        assert difference.mean() < 0.1, name
        assert (marks == 0) == (name in ("moved", "more samples")), (name, marks)
    images = [image for _, image, _ in found.values()]
    for one, other in pairwise(images):
        assert np.abs(one.astype(int) - other).mean() > 0.2


def test_the_version_is_blenders(life: dict[str, Any]) -> None:
    assert life["version"] in ("4.5.15", "5.2.3")


@pytest.mark.long
@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0])
def test_shadows_fall_away_from_the_sun(azimuth_deg: float) -> None:
    box = replace(BOX, size_m=(1.0, 1.0, 3.0), T_map_object=transform(np.eye(3), (0, 0, 1.75)))
    azimuth = np.radians(azimuth_deg)
    (frame,) = in_blender("backend.shadow", azimuth, box)
    away = -np.array([np.cos(azimuth), np.sin(azimuth)])
    ground = np.array([[*(2.0 * away), 0.25], [*(-2.0 * away), 0.25]])
    T_camera_map = np.linalg.inv(frame.T_map_camera)
    pixels = project(ground @ T_camera_map[:3, :3].T + T_camera_map[:3, 3], frame.intrinsics)
    shaded, lit = (frame.data[round(v), round(u)].mean() for u, v in pixels)
    assert shaded < 0.7 * lit


def test_the_sky_glows_on_the_side_of_the_sun() -> None:
    low = replace(SUNNY, sun_azimuth_rad=1.0, sun_elevation_rad=0.1)
    towards = np.array([np.cos(1.0), np.sin(1.0), 0.1])
    cameras = [
        camera(pose_looking_at((0, 0, 30), (0, 0, 30) + side * towards), modalities=(RGB,))
        for side in ((1, 1, 1), (-1, -1, 1))
    ]
    glowing, away = in_blender("backend.views", replace(rocky_world(), sky=low), cameras)
    assert glowing.data.mean() > away.data.mean() + 10


def test_albedo_beside_colour_is_that_of_a_render_of_its_own() -> None:
    pose = pose_looking_at((-6.0, -4.0, 5.25), (0.5, 0.0, 0.25))
    cameras = [camera(pose, modalities=each) for each in ((RGB,), (ALBEDO,), (RGB, ALBEDO))]
    rgb, albedo, *both = in_blender("backend.views", rocky_world(), cameras)
    assert [each.modality for each in both] == [RGB, ALBEDO]
    np.testing.assert_array_equal(both[0].data, rgb.data)
    np.testing.assert_array_equal(both[1].data, albedo.data)
