"""The ground's surface and masks against independent interpolation."""

import cv2
import numpy as np
import open3d as o3d
import pytest

from oaisys_core.scene import HeightField, PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.types import TriangleMesh, merge_meshes


@pytest.fixture
def ground() -> HeightField:
    rng = np.random.default_rng(2)
    return HeightField(rng.normal(0, 0.5, (9, 14)).astype(np.float32), (-3.0, 2.0), 0.25)


def maps(name: str) -> PbrMaps:
    grey = np.full((4, 4), 128, np.uint8)
    colour = np.stack([grey] * 3, axis=-1)
    return PbrMaps(name, colour, np.zeros((4, 4), np.float32), colour, grey, 2.0)


def test_height_equals_a_ray_cast_onto_the_triangles(ground: HeightField) -> None:
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(ground.vertices_m(), ground.triangles().astype(np.uint32))
    x0, y0, x1, y1 = ground.extent_m
    xy = np.random.default_rng(0).uniform((x0, y0), (x1, y1), (500, 2))
    down = np.tile((0.0, 0.0, -1.0), (500, 1))
    rays = np.hstack((xy, np.full((500, 1), 50.0), down)).astype(np.float32)
    expected_m = 50 - scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    assert np.allclose(ground.height_at(xy), expected_m, atol=2e-5)


def test_height_off_the_ground_is_nan(ground: HeightField) -> None:
    x0, y0, x1, y1 = ground.extent_m
    outside = [(x0 - 0.01, y0), (x0, y1 + 0.01), (x1 + 5, y0)]
    assert np.isnan(ground.height_at(outside)).all()
    assert np.isfinite(ground.height_at([(x0, y0), (x1, y1)])).all()


def test_triangles_face_upwards(ground: HeightField) -> None:
    corners = ground.vertices_m()[ground.triangles()]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()


def test_weights_equal_opencvs_bilinear_remap() -> None:
    rng = np.random.default_rng(4)
    first = rng.uniform(0, 1, (16, 16)).astype(np.float32)
    layers = (TerrainLayer("a", (3,), maps("a")), TerrainLayer("b", (7,), maps("b")))
    material = TerrainMaterial(layers, np.stack((first, 1 - first)), (-4.0, -4.0, 4.0, 4.0))
    xy = rng.uniform(-3.7, 3.7, (300, 2))
    texel = ((xy + 4) / 8 * 16 - 0.5).astype(np.float32)
    expected = cv2.remap(first, texel[:, :1], texel[:, 1:], cv2.INTER_LINEAR)[:, 0]
    # OpenCV interpolates with 5 fractional bits.
    assert np.allclose(material.weights_at(xy)[:, 0], expected, atol=1 / 32)
    clear = abs(expected - 0.5) > 1 / 32
    assert (material.semantic_ids_at(xy) == np.where(expected > 0.5, 3, 7))[clear].all()


def test_merged_meshes_keep_their_ids() -> None:
    corner = np.eye(3)
    one = TriangleMesh(corner, np.array([[0, 1, 2]], np.int32), np.array([4], np.uint16))
    two = TriangleMesh(corner + 1, np.array([[2, 1, 0]], np.int32), np.array([5], np.uint16))
    merged = merge_meshes([one, two])
    assert merged.triangles.tolist() == [[0, 1, 2], [5, 4, 3]]
    assert merged.semantic_ids is not None
    assert merged.semantic_ids.tolist() == [4, 5]
    assert merged.instance_ids is None
