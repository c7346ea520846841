"""Rays at instances against rays at copies of them, and instances in Blender."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender, in_new_blender
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from synthetic_worlds import camera, rocky_world, settings

from oaisys_core.geometry import pixel_rays, pose_looking_at, pose_looking_down
from oaisys_core.raycast.instance_boxes import BoxInstanceTarget
from oaisys_core.raycast.instances import matvec
from oaisys_core.raycast.objects import visible_boxes
from oaisys_core.raycast.prototype_meshes import PlacedPrototype, PrototypeMesh
from oaisys_core.raycast.targets import placement_targets
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.scene import MeshPrototype, Placement, Scene
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    NORMAL,
    SEMANTIC_0,
    FloatArray,
    PinholeIntrinsics,
    merge_meshes,
)

WIDE = PinholeIntrinsics(160, 120, 90.0, 90.0, 79.5, 59.5)
VIEWS = (
    camera(pose_looking_down(0.0, 0.0, 9.0, 0.3), WIDE),
    camera(pose_looking_at((-7.0, -6.0, 2.0), (1.0, 0.0, 0.0)), WIDE),
    camera(pose_looking_at((0.3, -0.2, 0.4), (5.0, 1.0, 0.2)), WIDE),
)


def overlapping_rocks(count: int = 600) -> list[PlacedPrototype]:
    """Rocks of two kinds, close together, that overlap."""
    rock = rocky_world().prototypes[0]
    stretch = np.array((0.4, 0.4, 2.0), np.float32)
    tall = replace(rock, name="tall", vertices_m=rock.vertices_m * stretch)
    return [
        _placed_prototypes(rock, 0, count, 1, 5),
        _placed_prototypes(tall, 1, count // 2, count + 1, 6),
    ]


def _placed_prototypes(
    prototype: MeshPrototype, index: int, count: int, first_id: int, seed: int
) -> PlacedPrototype:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    T[:, :3, :3] *= rng.uniform(0.05, 0.7, (count, 1, 1))
    T[:, :3, 3] = rng.uniform((-9, -9, -0.3), (9, 9, 0.6), (count, 3))
    ids = np.arange(first_id, first_id + count, dtype=np.uint32)
    return PlacedPrototype(PrototypeMesh(prototype), Placement(index, (10 + index,), T, ids))


@pytest.mark.long
@pytest.mark.parametrize("view", range(3))
def test_instances_are_hit_as_copies_of_them_are(view: int) -> None:
    placed = overlapping_rocks()
    boxes = BoxInstanceTarget(placed)
    copies = TriangleTarget([each.merge() for each in placed])
    directions = pixel_rays(WIDE) @ VIEWS[view].T_map_camera[:3, :3].T
    origin_m = VIEWS[view].T_map_camera[:3, 3]
    depth_m, triangles = boxes.intersect(origin_m, directions)
    expected_m, expected = copies.intersect(origin_m, directions)
    hit = expected != NO_ELEMENT
    assert hit.mean() > 0.2
    same = triangles == expected
    assert same.mean() > 0.999
    both = same & hit
    assert (depth_m[both].astype(np.float32) == expected_m[both].astype(np.float32)).mean() > 0.999
    np.testing.assert_allclose(depth_m[both], expected_m[both], rtol=1e-9)
    assert (boxes.instance_ids_of(triangles) == copies.instance_ids_of(triangles)).all()
    points_m = origin_m + depth_m[both, None] * directions[both]
    np.testing.assert_allclose(
        boxes.normals_of(triangles[both], points_m),
        copies.normals_of(triangles[both], points_m),
        atol=1e-9,
    )


def rays(view: int) -> tuple[FloatArray, FloatArray]:
    T_map_camera = VIEWS[view].T_map_camera
    return T_map_camera[:3, 3], pixel_rays(WIDE) @ T_map_camera[:3, :3].T


def test_products_have_the_same_bytes_however_vectors_lie_in_memory() -> None:
    R = overlapping_rocks(60)[0].placement.T_map_object[:, :3, :3]
    by_point = np.random.default_rng(3).normal(size=(60, 3))
    expected = matvec(R, by_point).tobytes()
    assert matvec(R, np.asfortranarray(by_point)).tobytes() == expected


@pytest.mark.blender
def test_embrees_instances_are_hit_as_copies_of_them_are() -> None:
    """Also far from the map's origin, where a float32 step is 6 cm."""
    away_m = np.array((5e5, -4e5, 300.0))
    placed = [moved(each, away_m) for each in overlapping_rocks()]
    copies = TriangleTarget([each.merge() for each in placed])
    views = [(o + away_m, d, None) for o, d in map(rays, range(3))]
    limits = np.full(views[1][1].shape[:-1], 6.0)
    xy_m = np.random.default_rng(2).uniform(-10, 10, (3001, 2)) + away_m[:2]
    many = [*views, (*views[1][:2], limits), (views[0][0], views[0][1][60, 80], None)]
    seen = in_blender("instances.casts", placed, many, xy_m)
    for index, (origin_m, directions, _) in enumerate(views):
        expected_m, expected = copies.intersect(origin_m, directions)
        depth_m, triangles = seen["found"][index]
        same, hit = triangles == expected, expected != NO_ELEMENT
        assert hit.mean() > 0.2
        assert same.mean() > 0.999
        np.testing.assert_allclose(depth_m[same & hit], expected_m[same & hit], rtol=1e-7)
        assert np.isposinf(depth_m[~hit & same]).all()
        assert (seen["ids"][index] == copies.instance_ids_of(expected)).mean() > 0.9999
        of_same = same[triangles != NO_ELEMENT]
        points_m = origin_m + depth_m[same & hit, None] * directions[same & hit]
        expected_normals = copies.normals_of(triangles[same & hit], points_m)
        np.testing.assert_allclose(seen["normals"][index][of_same], expected_normals, atol=1e-7)
        for one, other in zip(seen["found"][index], seen["again"][index], strict=True):
            assert one.tobytes() == other.tobytes()
    (all_m, all_triangles), (near_m, near) = seen["found"][1], seen["found"][3]
    within = all_m < 6.0
    assert 0.02 < within.mean() < 0.9
    assert (near == np.where(within, all_triangles, NO_ELEMENT)).all()
    assert (near_m == np.where(within, all_m, np.inf)).all()
    assert seen["found"][4][1] == seen["found"][0][1][60, 80]
    heights_m, expected_m = seen["heights_m"], copies.surface_height_m(xy_m)
    assert 0.1 < np.isfinite(expected_m).mean() < 0.95
    assert (np.isfinite(heights_m) == np.isfinite(expected_m)).mean() > 0.999
    both = np.isfinite(heights_m) & np.isfinite(expected_m)
    assert np.quantile(np.abs(heights_m - expected_m)[both], 0.999) < 1e-6


@pytest.mark.blender
def test_blenders_embree_and_open3ds_see_the_same_of_a_mesh() -> None:
    mesh = merge_meshes([each.merge() for each in overlapping_rocks()])
    views: list[tuple[Any, ...]] = [(*rays(view), None) for view in range(3)]
    views.append((views[1][0] + np.zeros((7, 3)), views[1][1][60:67, 80], None))
    found = in_blender("instances.mesh_casts", mesh, views)
    copies = TriangleTarget([mesh])
    for (origins_m, directions, _), (depth_m, triangles) in zip(views, found, strict=True):
        expected_m, expected = copies.intersect(origins_m, directions)
        same = triangles == expected
        assert same.mean() > 0.999
        np.testing.assert_array_equal(depth_m[same], expected_m[same])
    assert np.isfinite(found[0][0]).mean() > 0.2


@pytest.mark.long
@pytest.mark.blender
def test_embrees_structures_are_given_back() -> None:
    """Twenty that are not take 100 MB."""
    resident = in_new_blender("instances.resident_mb", overlapping_rocks(20_000), 22)
    assert resident[-1] - resident[2] < 30


def moved(placed: PlacedPrototype, by_m: FloatArray) -> PlacedPrototype:
    T = placed.placement.T_map_object.copy()
    T[:, :3, 3] += by_m
    return replace(placed, placement=replace(placed.placement, T_map_object=T))


def test_what_lies_beyond_the_limits_is_left_out() -> None:
    boxes = BoxInstanceTarget(overlapping_rocks())
    directions = pixel_rays(WIDE) @ VIEWS[1].T_map_camera[:3, :3].T
    origin_m = VIEWS[1].T_map_camera[:3, 3]
    depth_m, triangles = boxes.intersect(origin_m, directions)
    limits = np.full(depth_m.shape, 6.0)
    near_m, near = boxes.intersect(origin_m, directions, limits)
    within = depth_m < 6.0
    assert 0.02 < within.mean() < 0.9
    assert (near == np.where(within, triangles, NO_ELEMENT)).all()
    assert (near_m[within] == depth_m[within]).all()
    assert np.isposinf(near_m[~within]).all()


def test_heights_over_instances_are_those_over_copies() -> None:
    placed = overlapping_rocks()
    xy_m = np.random.default_rng(2).uniform(-10, 10, (3000, 2))
    heights_m = BoxInstanceTarget(placed).surface_height_m(xy_m)
    expected_m = TriangleTarget([each.merge() for each in placed]).surface_height_m(xy_m)
    assert 0.1 < np.isfinite(expected_m).mean() < 0.95
    assert (np.isfinite(heights_m) == np.isfinite(expected_m)).mean() > 0.999
    both = np.isfinite(heights_m) & np.isfinite(expected_m)
    assert np.quantile(np.abs(heights_m - expected_m)[both], 0.999) < 1e-6


def test_placements_without_triangles_are_no_target() -> None:
    nothing = np.empty((0, 4, 4)), np.empty(0, np.uint32)
    empty = MeshPrototype("empty", np.zeros((3, 3), np.float32), np.empty((0, 3), np.int32))
    scene = rocky_world()
    bare = replace(
        scene,
        prototypes=(*scene.prototypes, empty),
        placements=(
            Placement(0, (1,), *nothing),
            Placement(len(scene.prototypes), (2,), np.eye(4)[None], np.array([7], np.uint32)),
        ),
    )
    assert placement_targets.PlacementTargets(bare).targets == []


def test_one_large_mesh_many_times_is_seen_without_copies() -> None:
    """A million triangles twenty times would be 20 million."""
    side = 708
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    vertices = np.stack((x, y, 0.3 * np.cos(5 * x) * np.cos(4 * y)), -1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.stack((a, b, c, a, c, d), -1).reshape(-1, 3).astype(np.int32)
    cloth = MeshPrototype("cloth", vertices.astype(np.float32), triangles)
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, 0, 3] = 2.5 * np.arange(20)
    placement = Placement(0, (4,), T, np.arange(1, 21, dtype=np.uint32))
    caster = BoxInstanceTarget([PlacedPrototype(PrototypeMesh(cloth), placement)])
    xy_m = np.random.default_rng(3).uniform((-1, -1), (48.5, 1), (2000, 2))
    local_x = (xy_m[:, 0] + 1.25) % 2.5 - 1.25
    on = np.abs(local_x) < 0.99
    expected_m = 0.3 * np.cos(5 * local_x) * np.cos(4 * xy_m[:, 1])
    np.testing.assert_allclose(caster.surface_height_m(xy_m)[on], expected_m[on], atol=2e-5)


def test_both_ways_show_the_same_world(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = rocky_world()
    merged = images_of(scene)
    monkeypatch.setattr(placement_targets, "MERGED_TRIANGLES", 0)
    for one, other in zip(merged, images_of(scene), strict=True):
        assert np.isclose(one, other, atol=1e-6).mean() > 0.9995


def images_of(scene: Scene) -> list[NDArray[Any]]:
    views = [replace(v, modalities=(DEPTH, INSTANCE, SEMANTIC_0, NORMAL)) for v in VIEWS]
    backend = AnalyticBackend()
    backend.build(scene, lambda _: None)
    return [frame.data for frame in backend.render_all(views, settings(), lambda _: None)]


def test_rays_that_are_not_cast_at_instances_miss_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(placement_targets, "MERGED_TRIANGLES", 0)
    some = images_of(rocky_world())
    *_, from_among_them = pixels_of_rocks()
    assert 0.3 < from_among_them.mean() < 0.7
    monkeypatch.setattr(visible_boxes, "MAX_BOXES", 0)
    assert all(part is None for part in pixels_of_rocks())
    for one, other in zip(some, images_of(rocky_world()), strict=True):
        np.testing.assert_array_equal(one, other)


def pixels_of_rocks() -> list[Any]:
    (part,) = placement_targets.PlacementTargets(rocky_world()).targets
    return [part.visible_pixels(each) for each in VIEWS]


def test_a_lens_that_distorts_may_see_instances_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(placement_targets, "MERGED_TRIANGLES", 0)
    (part,) = placement_targets.PlacementTargets(rocky_world()).targets
    assert (
        part.visible_pixels(replace(VIEWS[0], intrinsics=replace(WIDE, distortion=(0.1,) * 5)))
        is None
    )


def rocky_scene(count: int) -> Scene:
    placed = overlapping_rocks(count)
    return replace(
        rocky_world(),
        prototypes=tuple(each.mesh.prototype for each in placed),
        placements=tuple(each.placement for each in placed),
    )


@pytest.mark.blender
def test_blender_stands_instances_and_objects_where_they_were_placed() -> None:
    scene = rocky_scene(400)
    many, few = scene.placements
    few = replace(few, T_map_object=few.T_map_object[:60], instance_ids=few.instance_ids[:60])
    scene = replace(scene, placements=(many, few))
    other = replace(many, T_map_object=many.T_map_object[::-1].copy())
    fewer = replace(few, T_map_object=few.T_map_object[:50], instance_ids=few.instance_ids[:50])
    scenes = [
        scene,
        replace(scene, placements=(other, few)),
        replace(scene, placements=(other, fewer)),
        replace(scene, placements=(fewer,)),
        scene,
    ]
    found = in_blender("passes.evaluated", scenes)
    expected = [(many, few), (other, few), (other, fewer), (None, fewer), (many, few)]
    for (poses, things, _), (placed, separate) in zip(found, expected, strict=True):
        if placed is None:
            assert len(poses) == 0
        else:
            np.testing.assert_allclose(poses, placed.T_map_object, atol=2e-6)
        np.testing.assert_allclose(things, separate.T_map_object, atol=2e-6)
    assert found[0][2] == found[-1][2]


def test_rays_that_begin_inside_boxes_hit_what_one_ray_from_there_hits() -> None:
    placed = overlapping_rocks()
    boxes, copies = BoxInstanceTarget(placed), TriangleTarget([each.merge() for each in placed])
    rng = np.random.default_rng(3)
    origins_m = boxes.high_m[rng.integers(0, len(boxes.high_m), 400)] - 0.02
    directions = rng.normal(size=(400, 3))
    found_m, _ = boxes.intersect(origins_m, directions)
    expected_m, _ = copies.intersect(origins_m, directions)
    assert 20 < np.isfinite(expected_m).sum() < 400
    np.testing.assert_allclose(found_m, expected_m, rtol=1e-5)
