"""Range, normals, flow, albedo and labels by level of every backend against closed forms."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from blender_process import in_blender
from landmarks import straightened
from numpy.typing import NDArray
from synthetic_worlds import (
    BOX,
    CENTRED,
    SKEWED,
    SPHERE,
    camera,
    flat_world,
    rocky_world,
    settings,
)

from oaisys_core.color import linear
from oaisys_core.geometry import (
    pixel_rays,
    pose_looking_at,
    pose_looking_down,
    transform,
    unproject,
)
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import Frame, PinholeIntrinsics, modality_spec

BACKENDS = ["analytic", pytest.param("blender", marks=pytest.mark.blender)]

PASSES = ("depth", "range", "normal", "flow", "semantic_0", "semantic_1", "instance", "albedo")
BENT = replace(SKEWED, distortion=(-0.12, 0.02, 0.003, -0.002, 0.0))
FIRST = pose_looking_at((-6.0, -4.0, 5.25), (0.5, 0.0, 0.25), (0.2, 0.1, 1.0))
SECOND = pose_looking_at((-5.4, -4.3, 4.9), (0.6, 0.3, 0.25), (0.15, 0.1, 1.0))


def moved_sphere() -> Scene:
    turn = cv2.Rodrigues(np.array([0.2, -0.1, 0.4]))[0]
    T = transform(turn, SPHERE.T_map_object[:3, 3] + (0.3, -0.4, 0.2))
    scene = levelled()
    return replace(scene, primitives=(replace(scene.primitives[0], T_map_object=T), BOX))


@cache
def levelled() -> Scene:
    """The flat world with a second level of labels on the sphere and the first layer."""
    scene = flat_world()
    first, second = scene.material.layers
    layers = (replace(first, semantic_ids=(1, 101)), second)
    sphere = replace(SPHERE, semantic_ids=(20, 120))
    return replace(
        scene,
        material=replace(scene.material, layers=layers),
        primitives=(sphere, BOX),
        sky=replace(scene.sky, semantic_ids=(7, 107)),
    )


def samples(
    backend: str, scenes: Sequence[Scene], cameras: Sequence[PlacedCamera]
) -> list[tuple[Frame, ...]]:
    if backend == "blender":
        found: list[tuple[Frame, ...]] = in_blender("passes.samples", scenes, cameras)
        return found
    analytic = AnalyticBackend()
    analytic.build(scenes[0], lambda _: None)
    frames = [analytic.render_all([cameras[0]], settings(), lambda _: None)]
    for scene, each in zip(scenes[1:], cameras[1:], strict=True):
        analytic.update(scene)
        frames.append(analytic.render_all([each], settings(), lambda _: None))
    return frames


@cache
def views(backend: str, intrinsics: PinholeIntrinsics) -> list[dict[str, NDArray[Any]]]:
    """Two samples: camera and sphere have moved in between."""
    first = camera(FIRST, intrinsics, PASSES)
    T_first = first.T_map_camera
    second = replace(camera(SECOND, intrinsics, PASSES), T_map_previous=T_first)
    frames = samples(backend, [levelled(), moved_sphere()], [first, second])
    return [{f.modality: f.data for f in sample} for sample in frames]


def projected(
    points_m: NDArray[Any], T_map_camera: NDArray[Any], intrinsics: PinholeIntrinsics
) -> NDArray[Any]:
    """(N, 2) pixels by OpenCV."""
    T = np.linalg.inv(T_map_camera)
    distortion = np.array(intrinsics.distortion) if intrinsics.distortion else None
    pixels, _ = cv2.projectPoints(
        points_m, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], intrinsics.K, distortion
    )
    return np.asarray(pixels[:, 0])


def points_of(seen: dict[str, NDArray[Any]], view: PlacedCamera) -> NDArray[Any]:
    """(H, W, 3) points in map, from OpenCV's rays."""
    k = view.intrinsics
    v, u = np.mgrid[: k.height_px, : k.width_px]
    pixels = np.stack((u, v), -1).reshape(-1, 2)
    distortion = np.array(k.distortion) if k.distortion else np.zeros(5)
    rays = straightened(pixels, k.K, distortion).reshape(*u.shape, 2)
    rays = np.dstack((rays, np.ones(u.shape)))
    T = view.T_map_camera
    with np.errstate(invalid="ignore"):
        return np.asarray((rays * seen["depth"][..., None]) @ T[:3, :3].T + T[:3, 3])


@pytest.mark.parametrize("intrinsics", [SKEWED, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_every_pass_has_its_type_and_shape(backend: str, intrinsics: PinholeIntrinsics) -> None:
    for seen in views(backend, intrinsics):
        for modality in PASSES:
            spec = modality_spec(modality)
            channels = (spec.channels,) if spec.channels > 1 else ()
            assert seen[modality].dtype == spec.dtype
            assert seen[modality].shape == (intrinsics.height_px, intrinsics.width_px, *channels)


@pytest.mark.parametrize("intrinsics", [SKEWED, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_range_is_the_distance_of_the_point_seen(
    backend: str, intrinsics: PinholeIntrinsics
) -> None:
    seen = views(backend, intrinsics)[0]
    view = camera(FIRST, intrinsics)
    hit = np.isfinite(seen["depth"])
    distance_m = np.linalg.norm(points_of(seen, view)[hit] - view.T_map_camera[:3, 3], axis=-1)
    np.testing.assert_allclose(seen["range"][hit], distance_m, rtol=1e-6)
    assert np.isposinf(seen["range"][~hit]).all()


@pytest.mark.parametrize("intrinsics", [SKEWED, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_normals_are_those_of_plane_and_sphere(backend: str, intrinsics: PinholeIntrinsics) -> None:
    seen = views(backend, intrinsics)[0]
    view = camera(FIRST, intrinsics)
    R = view.T_map_camera[:3, :3]
    ground = (seen["instance"] == 0) & np.isfinite(seen["depth"])
    np.testing.assert_allclose(seen["normal"][ground], np.tile(R[2], (ground.sum(), 1)), atol=1e-6)
    ball = seen["instance"] == SPHERE.instance_id
    outward = points_of(seen, view)[ball] - SPHERE.T_map_object[:3, 3]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    np.testing.assert_allclose(seen["normal"][ball], outward @ R, atol=1e-5)
    assert (seen["normal"][~np.isfinite(seen["depth"])] == 0).all()
    rays = points_of(seen, view) - view.T_map_camera[:3, 3]
    towards = (seen["normal"] * (rays @ R)).sum(axis=-1)[np.isfinite(seen["depth"])]
    assert (towards < 0).all()


@pytest.mark.parametrize("intrinsics", [SKEWED, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_flow_is_where_points_were_projected_before(
    backend: str, intrinsics: PinholeIntrinsics
) -> None:
    first, second = views(backend, intrinsics)
    assert np.isnan(first["flow"]).all()
    then, now = (camera(pose, intrinsics) for pose in (FIRST, SECOND))
    points_m = points_of(second, now)
    v, u = np.mgrid[: intrinsics.height_px, : intrinsics.width_px]
    ball = second["instance"] == SPHERE.instance_id
    T_before = SPHERE.T_map_object @ np.linalg.inv(moved_sphere().primitives[0].T_map_object)
    points_m[ball] = points_m[ball] @ T_before[:3, :3].T + T_before[:3, 3]
    hit = np.isfinite(second["depth"])
    assert ball.sum() > 30
    before = projected(points_m[hit], then.T_map_camera, intrinsics)
    expected = np.column_stack((u[hit], v[hit])) - before
    np.testing.assert_allclose(second["flow"][hit], expected, atol=2e-3)


def test_flow_of_the_sky_is_that_of_turning_alone() -> None:
    up = camera(pose_looking_at((0, 0, 9), (0, 9, 15)), CENTRED, ("flow",))
    turned = camera(pose_looking_at((3, 1, 9), (3.4, 10, 15)), CENTRED, ("flow",))
    turned = replace(turned, T_map_previous=up.T_map_camera)
    ((frame,),) = samples("analytic", [flat_world()], [turned])
    v, u = np.mgrid[:48, :64]
    rays = np.linalg.solve(CENTRED.K, np.stack((u, v, np.ones_like(u))).reshape(3, -1))
    H = CENTRED.K @ up.T_map_camera[:3, :3].T @ turned.T_map_camera[:3, :3]
    x, y, z = H @ rays
    expected = np.stack((u.ravel() - x / z, v.ravel() - y / z), -1).reshape(48, 64, 2)
    np.testing.assert_allclose(frame.data, expected, atol=1e-4)


def test_what_was_behind_the_camera_has_no_flow() -> None:
    down = camera(pose_looking_down(0, 0, 9), CENTRED, ("flow",))
    behind = replace(down, T_map_previous=down.T_map_camera @ np.diag((1.0, -1.0, -1.0, 1.0)))
    ((frame,),) = samples("analytic", [flat_world()], [behind])
    assert np.isnan(frame.data).all()


@pytest.mark.parametrize("k3", [0.3, -0.02], ids=["grows", "folds"])
def test_where_a_lens_was_not_known_there_is_no_flow(k3: float) -> None:
    """Its polynomial had values up to 1e38 beyond the image, or led back into it."""
    lens = replace(CENTRED, distortion=(0.05, 0.02, 0.001, 0.001, k3))
    before = camera(pose_looking_at((0, 0, 9), (9, 0, 2)), lens, ("flow",))
    for degrees in (5, 40, 70, 95):
        along = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        now = camera(pose_looking_at((0, 0, 9), (9 * along[0], 9 * along[1], 2)), lens, ("flow",))
        now = replace(now, T_map_previous=before.T_map_camera)
        ((frame,),) = samples("analytic", [flat_world()], [now])
        flow = frame.data.astype(float)
        assert not np.isinf(flow).any()
        assert np.nanmax(np.abs(flow), initial=0) < 1e4
        # The camera only turns: where a flow is known, it leads back to the pixel's direction.
        known = np.isfinite(flow).all(axis=-1)
        assert known.any() or degrees > 40
        assert not known.all() or degrees < 70
        v, u = np.mgrid[:48, :64]
        then = np.stack((u, v), axis=-1) - flow
        rays = unproject(then[known], np.ones(known.sum()), lens)
        expected = (pixel_rays(lens) @ now.T_map_camera[:3, :3].T)[known]
        found = rays @ before.T_map_camera[:3, :3].T
        cosine = (found * expected).sum(-1) / np.linalg.norm(found, axis=-1)
        assert (cosine / np.linalg.norm(expected, axis=-1) > 1 - 1e-6).all()


def test_a_new_object_has_no_flow_and_others_keep_theirs() -> None:
    scene = flat_world()
    down = camera(pose_looking_down(0.5, 0, 9), CENTRED, ("flow", "instance"))
    again = replace(down, T_map_previous=down.T_map_camera)
    scenes = [replace(scene, primitives=(BOX,)), scene]
    flow, instance = samples("analytic", scenes, [down, again])[1]
    new = instance.data == SPHERE.instance_id
    assert np.isnan(flow.data[new]).all()
    np.testing.assert_allclose(flow.data[~new], 0.0, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_labels_of_every_level_are_rendered(backend: str) -> None:
    seen = views(backend, SKEWED)[0]
    ball = seen["instance"] == SPHERE.instance_id
    assert (seen["semantic_1"][ball] == 120).all()
    assert (seen["semantic_1"][seen["instance"] == BOX.instance_id] == 0).all()
    pairs = {(a, b) for a, b in zip(seen["semantic_0"].flat, seen["semantic_1"].flat, strict=True)}
    assert pairs == {(1, 101), (2, 0), (20, 120), (21, 0)}


@pytest.mark.parametrize("intrinsics", [SKEWED, BENT], ids=["pinhole", "lens"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_albedo_is_the_colour_without_light(backend: str, intrinsics: PinholeIntrinsics) -> None:
    seen = views(backend, intrinsics)[0]
    for primitive in (SPHERE, BOX):
        own = seen["instance"] == primitive.instance_id
        inner = own & (cv2.erode(own.astype(np.uint8), np.ones((5, 5))) > 0)
        expected = np.array(primitive.color_srgb) * 255
        assert inner.sum() > 20
        assert np.abs(seen["albedo"][inner] - expected).max() <= 2
    ground = seen["instance"] == 0
    mean = linear(seen["albedo"][ground] / 255).mean(axis=0)
    assert (mean > 0.08).all()
    assert (mean < 0.7).all()


@pytest.mark.blender
def test_rocks_have_the_same_passes_in_both_backends() -> None:
    view = camera(pose_looking_at((-7.0, -6.0, 4.0), (1.0, 0.0, 0.0)), CENTRED, PASSES[:4])
    view = replace(view, T_map_previous=camera(FIRST).T_map_camera)
    (one,), (other,) = (samples(name, [rocky_world()], [view]) for name in ("analytic", "blender"))
    for a, b in zip(one, other, strict=True):
        close = np.isclose(a.data, b.data, rtol=1e-3, atol=1e-3, equal_nan=True)
        assert close.mean() > 0.995
