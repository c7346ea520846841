"""Ray casting against closed forms, brute force and OpenCV's projection."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import SKEWED, camera, rocky_world

from oaisys_core.geometry import pixel_rays, pose_looking_at, pose_looking_down
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT
from oaisys_core.raycast.triangles import HeightFieldTarget, TriangleTarget
from oaisys_core.scene import HeightField, PlacedCamera
from oaisys_core.types import FloatArray, TriangleMesh


class CameraHits(NamedTuple):
    depth_m: NDArray[np.float32]
    triangle_ids: NDArray[np.int64]
    instance_ids: NDArray[np.uint32]
    points_m: FloatArray


def cast(target: TriangleTarget, view: PlacedCamera) -> CameraHits:
    """What each pixel of a camera hits at its centre."""
    origin_m = view.T_map_camera[:3, 3]
    directions = pixel_rays(view.intrinsics) @ view.T_map_camera[:3, :3].T
    depth_m, triangle_ids = target.intersect(origin_m, directions)
    with np.errstate(invalid="ignore"):
        points_m = origin_m + depth_m[..., None] * directions
    ids = target.instance_ids_of(triangle_ids)
    return CameraHits(depth_m.astype(np.float32), triangle_ids, ids, points_m)


def square(height_m: float, half_m: float = 5.0, instance_id: int = 0) -> TriangleMesh:
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=np.float64)
    return TriangleMesh(
        corners * half_m + (0, 0, height_m),
        np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32),
        instance_ids=np.full(2, instance_id, dtype=np.uint32),
    )


def rocky_mesh() -> TriangleMesh:
    ground = rocky_world().ground
    return TriangleMesh(ground.vertices_m().astype(np.float64), ground.triangles())


@pytest.mark.parametrize("far_m", [0.0, 500_000.0])
def test_depth_of_a_tilted_plane_is_exact_wherever_it_lies(far_m: float) -> None:
    rng = np.random.default_rng(2)
    xy_m = np.stack(np.meshgrid(np.linspace(-30, 30, 41), np.linspace(-30, 30, 41)), -1)
    slope = np.array([0.3, -0.2])
    corner = np.array([far_m, 2 * far_m, 3.0])
    vertices = np.concatenate((xy_m, (xy_m @ slope)[..., None]), axis=-1).reshape(-1, 3) + corner
    index = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    triangles = np.stack((a, b, c, a, c, d), -1).reshape(-1, 3).astype(np.int32)
    target = TriangleTarget([TriangleMesh(vertices, triangles)])
    normal = np.array([*-slope, 1.0])
    for _ in range(4):
        eye = corner + np.append(rng.uniform(-5, 5, 2), 8.0)
        view = camera(pose_looking_at(eye, corner + np.append(rng.uniform(-3, 3, 2), 0.0)), SKEWED)
        hits = cast(target, view)
        hit = hits.triangle_ids != NO_ELEMENT
        v, u = np.nonzero(hit)
        rays = np.linalg.solve(SKEWED.K, np.stack((u, v, np.ones(len(u)))))
        depth_m = normal @ (corner - eye) / (normal @ view.T_map_camera[:3, :3] @ rays)
        assert hit.mean() > 0.5
        np.testing.assert_allclose(hits.depth_m[hit], depth_m, rtol=1.2e-7)
        np.testing.assert_allclose((hits.points_m[hit] - corner) @ normal, 0, atol=1e-8)


def test_hits_project_back_to_their_pixel_centres() -> None:
    view = camera(pose_looking_at((-9, -7, 6), (0, 0, 0), (0.2, 0.1, 1)), SKEWED)
    hits = cast(TriangleTarget([rocky_mesh()]), view)
    v, u = np.nonzero(hits.triangle_ids != NO_ELEMENT)
    T_camera_map = np.linalg.inv(view.T_map_camera)
    rotation, _ = cv2.Rodrigues(T_camera_map[:3, :3])
    pixels, _ = cv2.projectPoints(
        hits.points_m[v, u], rotation, T_camera_map[:3, 3], SKEWED.K, None
    )
    assert len(u) > 1000
    np.testing.assert_allclose(pixels[:, 0], np.column_stack((u, v)), atol=1e-6)


def test_the_first_triangle_is_that_of_a_brute_force_search() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-2, 2, (60, 1, 3)) + rng.normal(scale=0.7, size=(60, 3, 3))
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(180, dtype=np.int32).reshape(-1, 3))
    origin_m = np.array([0.1, -6.0, 0.3])
    directions = rng.normal(size=(500, 3)) * (0.3, 0, 0.3) + (0, 1.0, 0)
    distances, found = TriangleTarget([mesh]).intersect(origin_m, directions)

    edges = corners[:, 1:] - corners[:, :1]
    expected = np.full((500, 60), np.inf)
    for ray, direction in enumerate(directions):
        for index in range(60):
            u, v, t = np.linalg.solve(
                np.column_stack((*edges[index], -direction)), origin_m - corners[index, 0]
            )
            if t > 0 and u > 0 and v > 0 and u + v < 1:
                expected[ray, index] = t
    hit = np.isfinite(expected).any(axis=1)
    assert 100 < hit.sum() < 500
    assert (np.isfinite(distances) == hit).all()
    assert (found[hit] == expected[hit].argmin(axis=1)).all()
    np.testing.assert_allclose(distances[hit], expected[hit].min(axis=1), rtol=1e-12)


def test_views_are_equal_bit_for_bit_however_often_the_structure_is_built() -> None:
    mesh = rocky_mesh()
    view = camera(pose_looking_at((-9, -7, 6), (0, 0, 0)))
    first, *others = [cast(TriangleTarget([mesh]), view) for _ in range(12)]
    for other in others:
        assert first.depth_m.tobytes() == other.depth_m.tobytes()
        assert first.triangle_ids.tobytes() == other.triangle_ids.tobytes()


def test_a_height_field_is_hit_as_its_mesh_is_bit_for_bit() -> None:
    rng = np.random.default_rng(7)
    elevation_m = rng.uniform(0, 0.3, (37, 53)).astype(np.float32)
    ground = HeightField(elevation_m, (-3.1, -2.3), 0.13)
    mesh = TriangleMesh(ground.vertices_m().astype(np.float64), ground.triangles())
    fields, arrays = HeightFieldTarget(ground, mesh), TriangleTarget([mesh])
    directions = rng.normal(size=(20_000, 3)) - (0, 0, 1.5)
    distance_m, elements = fields.intersect(np.array((0.2, 0.1, 1.4)), directions)
    expected_m, expected = arrays.intersect(np.array((0.2, 0.1, 1.4)), directions)
    assert distance_m.tobytes() == expected_m.tobytes()
    assert (elements == expected).all()
    assert len(np.unique(elements)) > mesh.triangles.shape[0] / 2
    hit = elements[elements != NO_ELEMENT]
    places_m = np.zeros((len(hit), 3))
    assert fields.normals_of(hit, places_m).tobytes() == arrays.normals_of(hit, places_m).tobytes()


def test_ids_are_those_of_the_nearest_mesh() -> None:
    target = TriangleTarget([square(0.0), square(2.0, half_m=0.5, instance_id=70_000)])
    hits = cast(target, camera(pose_looking_down(0, 0, 6)))
    above = np.isclose(hits.depth_m, 4.0)
    assert above.sum() == 14 * 14
    assert set(np.unique(hits.depth_m)) == {np.float32(4.0), np.float32(6.0)}
    assert (hits.instance_ids == np.where(above, 70_000, 0)).all()


def test_rays_that_hit_nothing_say_so() -> None:
    view = camera(pose_looking_at((0, 0, 3), (0, 9, 3.1)))
    hits = cast(TriangleTarget([square(0.0, half_m=1.0, instance_id=4)]), view)
    assert np.isposinf(hits.depth_m).all()
    assert (hits.triangle_ids == NO_ELEMENT).all()
    assert not hits.instance_ids.any()


def test_no_triangles_at_all_are_no_error() -> None:
    target = TriangleTarget([])
    view = camera(pose_looking_down(0, 0, 6))
    assert np.isposinf(cast(target, view).depth_m).all()
    assert np.isnan(target.surface_height_m([(0.0, 0.0)])).all()


def test_triangles_without_area_do_no_harm() -> None:
    flat = square(0.0)
    line = TriangleMesh(np.array([(-5.0, 0, 1), (0, 0, 1), (5, 0, 1)]), np.array([[0, 1, 2]]))
    view = camera(pose_looking_down(0, 0, 6))
    hits = cast(TriangleTarget([flat, line]), view)
    assert not np.isnan(hits.depth_m).any()
    assert (hits.depth_m == 6).mean() > 0.95


def test_heights_are_those_of_the_topmost_surface() -> None:
    ground = rocky_world().ground
    rng = np.random.default_rng(6)
    xy_m = rng.uniform(-21, 21, (2000, 2))
    target = TriangleTarget([rocky_mesh(), square(5.0, half_m=2.0)])
    height_m = target.surface_height_m(xy_m)
    under_roof = (np.abs(xy_m) < 2.0).all(axis=1)
    expected_m = np.where(under_roof, 5.0, ground.height_at(xy_m))
    assert under_roof.any()
    assert np.isnan(expected_m).any()
    np.testing.assert_allclose(height_m, expected_m, atol=2e-6)
