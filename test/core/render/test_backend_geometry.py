"""Depth and labels of every backend against closed forms."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender, in_new_blender
from numpy.typing import NDArray
from synthetic_worlds import (
    BOX,
    CENTRED,
    EXTENT_M,
    SKEWED,
    SKY_ID,
    SPHERE,
    camera,
    flat_world,
    rocky_world,
    settings,
)

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0, Frame, PinholeIntrinsics

BACKENDS = ["analytic", pytest.param("blender", marks=pytest.mark.blender)]

GROUND_M = 0.25
NADIR = camera(pose_looking_down(0.3, -0.2, 10.25, 0.7), CENTRED)
STEEP = camera(pose_looking_at((-6.0, -4.0, 5.25), (0.5, 0.0, 0.25), (0.2, 0.1, 1.0)), SKEWED)
"""Rolled, and up to 60 degrees and more off the ground's normal."""
LEVEL = camera(pose_looking_at((-8.0, 3.0, 1.75), (0.0, 0.0, 1.5)), CENTRED)
FLAT_VIEWS = (NADIR, STEEP, LEVEL)
ROCKY_VIEWS = (
    camera(pose_looking_down(0.0, 0.0, 9.0, 0.3), CENTRED),
    camera(pose_looking_at((-7.0, -6.0, 4.0), (1.0, 0.0, 0.0), (0.1, 0.0, 1.0)), SKEWED),
)


def rendered(backend: str, scene: Scene, cameras: Sequence[PlacedCamera]) -> tuple[Frame, ...]:
    if backend == "blender":
        frames: tuple[Frame, ...] = in_blender("backend.views", scene, cameras)
        return frames
    analytic = AnalyticBackend()
    analytic.build(scene, lambda _: None)
    return analytic.render_all(cameras, settings(), lambda _: None)


@cache
def flat_views(backend: str) -> tuple[Frame, ...]:
    return rendered(backend, flat_world(), FLAT_VIEWS)


def images(frames: Sequence[Frame], view: int) -> dict[str, NDArray[Any]]:
    return {frame.modality: frame.data for frame in frames[3 * view : 3 * view + 3]}


def rays_of(intrinsics: PinholeIntrinsics) -> NDArray[Any]:
    """(H, W, 3) rays of depth 1 from the inverse camera matrix, written anew for the tests."""
    v, u = np.mgrid[: intrinsics.height_px, : intrinsics.width_px]
    pixels = np.stack((u, v, np.ones_like(u)), axis=-1)
    return np.asarray(pixels @ np.linalg.inv(intrinsics.K).T)


@pytest.mark.parametrize("view", range(3))
@pytest.mark.parametrize("backend", BACKENDS)
def test_depth_of_level_ground_is_exact(backend: str, view: int) -> None:
    seen = images(flat_views(backend), view)
    T = FLAT_VIEWS[view].T_map_camera
    rays = rays_of(FLAT_VIEWS[view].intrinsics)
    with np.errstate(divide="ignore"):
        depth_m = (GROUND_M - T[2, 3]) / (rays @ T[2, :3])
    ground = np.isin(seen[SEMANTIC_0], (1, 2))
    cos_incidence = -(rays @ T[2, :3]) / np.linalg.norm(rays, axis=-1)
    near = ground & (depth_m < 10.5) & (cos_incidence > 0.5)
    assert ground.sum() > 300
    assert near.any() or view == 2
    assert np.abs(seen[DEPTH] - depth_m)[near].max(initial=0) <= 1e-5
    np.testing.assert_allclose(seen[DEPTH][ground], depth_m[ground], rtol=1e-6)


@pytest.mark.parametrize("view", range(3))
@pytest.mark.parametrize("backend", BACKENDS)
def test_depth_of_a_sphere_is_exact(backend: str, view: int) -> None:
    seen = images(flat_views(backend), view)
    T = FLAT_VIEWS[view].T_map_camera
    rays = rays_of(FLAT_VIEWS[view].intrinsics) @ T[:3, :3].T
    ball = seen[INSTANCE] == SPHERE.instance_id
    assert ball.sum() > 30
    assert (seen[SEMANTIC_0][ball] == SPHERE.semantic_ids[0]).all()
    to_centre = SPHERE.T_map_object[:3, 3] - T[:3, 3]
    along = rays[ball] @ to_centre
    squared = (rays[ball] ** 2).sum(axis=1)
    surplus = along**2 - squared * (to_centre @ to_centre - SPHERE.size_m[0] ** 2)
    assert (surplus > 0).all()
    depth_m = (along - np.sqrt(surplus)) / squared
    np.testing.assert_allclose(seen[DEPTH][ball], depth_m, rtol=1e-6)


@pytest.mark.parametrize("view", range(3))
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_box_is_hit_on_its_faces_and_from_outside(backend: str, view: int) -> None:
    seen = images(flat_views(backend), view)
    T = FLAT_VIEWS[view].T_map_camera
    box = seen[INSTANCE] == BOX.instance_id
    assert box.sum() > 20
    assert (seen[SEMANTIC_0][box] == BOX.semantic_ids[0]).all()
    points = T[:3, 3] + seen[DEPTH][box, None] * (
        rays_of(FLAT_VIEWS[view].intrinsics)[box] @ T[:3, :3].T
    )
    T_box_map = np.linalg.inv(BOX.T_map_object)
    inside = (points @ T_box_map[:3, :3].T + T_box_map[:3, 3]) / (np.array(BOX.size_m) / 2)
    np.testing.assert_allclose(np.abs(inside).max(axis=1), 1.0, atol=1e-5)
    face = np.abs(inside).argmax(axis=1)
    rows = np.arange(len(inside))
    eye = (T_box_map @ T[:, 3])[:3] / (np.array(BOX.size_m) / 2)
    assert (inside[rows, face] * eye[face] > 1).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_beyond_the_ground_there_is_sky(backend: str) -> None:
    seen = images(flat_views(backend), 2)
    T = LEVEL.T_map_camera
    rays = rays_of(LEVEL.intrinsics) @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (GROUND_M - T[2, 3]) / rays[..., 2]
        xy_m = T[:2, 3] + reach[..., None] * rays[..., :2]
    on_ground = (reach > 0) & (np.abs(xy_m) < EXTENT_M / 2).all(axis=-1)
    nothing = ~on_ground & (seen[INSTANCE] == 0)
    assert nothing.sum() > 300
    assert np.isposinf(seen[DEPTH][nothing]).all()
    assert (seen[SEMANTIC_0][nothing] == SKY_ID).all()
    assert np.isfinite(seen[DEPTH][~nothing]).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_ground_is_labelled_by_its_heaviest_layer(backend: str) -> None:
    seen = images(flat_views(backend), 0)
    T = NADIR.T_map_camera
    points = T[:3, 3] + seen[DEPTH][..., None] * (rays_of(NADIR.intrinsics) @ T[:3, :3].T)
    ground = seen[INSTANCE] == 0
    material = flat_world().material
    expected = np.array([1, 2])[material.weights_at(points[ground][:, :2]).argmax(axis=1)]
    assert set(expected) == {1, 2}
    assert (seen[SEMANTIC_0][ground] == expected).mean() > 0.999


@pytest.mark.blender
def test_both_backends_see_the_same_rocky_world() -> None:
    by_blender = rendered("blender", rocky_world(), ROCKY_VIEWS)
    by_rays = rendered("analytic", rocky_world(), ROCKY_VIEWS)
    for view in range(2):
        one, other = images(by_blender, view), images(by_rays, view)
        assert len(np.unique(one[INSTANCE])) > 8
        same = one[INSTANCE] == other[INSTANCE]
        assert same.mean() > 0.998
        both = same & np.isfinite(one[DEPTH]) & np.isfinite(other[DEPTH])
        off = np.abs(one[DEPTH][both] / other[DEPTH][both] - 1)
        assert np.quantile(off, 0.999) < 1e-4
        assert (one[SEMANTIC_0] == other[SEMANTIC_0]).mean() > 0.998


@pytest.mark.blender
def test_two_processes_see_the_same_bytes() -> None:
    first = rendered("blender", rocky_world(), ROCKY_VIEWS)
    second = in_new_blender("backend.views", rocky_world(), ROCKY_VIEWS)
    assert [f.data.tobytes() for f in first] == [f.data.tobytes() for f in second]
