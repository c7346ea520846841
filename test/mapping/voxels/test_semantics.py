"""Classes of voxels and of mesh vertices."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_views import CAMERA, UP, camera_at, flight, fly, plane_depth_m

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert
from oaisys_mapping.mesh_io import read_class_names, read_ply, write_ply
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_mapping.voxels.block_layout import CLASSES_KEPT
from oaisys_mapping.voxels.semantic_fusion import (
    class_color,
    fuse_classes,
    most_likely,
)

ABOVE = camera_at((0.01, 0, 6), (0, 0, 0))
GROUND_M = plane_depth_m(ABOVE, UP, 0.0)


def halves(left: int, right: int) -> np.ndarray:
    labels = np.full((240, 320), left, np.uint16)
    labels[:, 160:] = right
    return labels


def test_vertices_have_the_most_frequent_class() -> None:
    volume = TsdfVolume(TsdfConfig(semantic=True))
    for labels in (halves(3, 9), halves(3, 9), halves(3, 5), halves(0, 0)):
        volume.integrate(GROUND_M, None, CAMERA, ABOVE, labels)
    mesh = volume.extract_mesh()
    T_camera_map = invert(ABOVE)
    x = (mesh.vertices_m @ T_camera_map[:3, :3].T + T_camera_map[:3, 3])[:, 0]
    assert mesh.class_ids is not None
    assert mesh.class_probabilities is not None
    assert mesh.class_ids.dtype == np.uint16
    assert (mesh.class_ids[x < -0.15] == 3).all()
    assert (mesh.class_ids[x > 0.15] == 9).all()
    np.testing.assert_allclose(mesh.class_probabilities[x < -0.15], 1.0)
    np.testing.assert_allclose(mesh.class_probabilities[x > 0.15], 2 / 3, rtol=1e-5)
    points_m = np.array([(0.0, 0.0, 9.0), *mesh.vertices_m[::50]])
    ids, shares = volume.classes_at(points_m)
    assert (ids[0], shares[0]) == (0, 0)
    away = np.abs(x[::50]) > 0.25
    assert np.array_equal(ids[1:][away], mesh.class_ids[::50][away])
    np.testing.assert_allclose(shares[1:][away], mesh.class_probabilities[::50][away], rtol=1e-5)


def test_volumes_without_classes_refuse_class_queries() -> None:
    volume = TsdfVolume()
    volume.integrate(GROUND_M, None, CAMERA, ABOVE, halves(1, 2))
    assert volume.extract_mesh().class_ids is None
    with pytest.raises(InvalidInputError, match="semantic"):
        volume.classes_at(np.array([(0.0, 0.0, 0.0)]))


def test_the_heaviest_class_is_kept_among_many() -> None:
    """Against counting, where one class has more than a quarter of the weight."""
    rng = np.random.default_rng(3)
    voxels, rounds = 200, 60
    ids = np.zeros((voxels, CLASSES_KEPT), np.uint16)
    weights = np.zeros((voxels, CLASSES_KEPT), np.float32)
    counts = np.zeros((voxels, 20))
    for _ in range(rounds):
        labels = np.where(rng.uniform(size=voxels) < 0.5, 7, rng.integers(1, 20, voxels))
        ones = np.ones(voxels, np.float32)
        fuse_classes(ids, weights, np.arange(voxels), labels.astype(np.uint16), ones)
        counts[np.arange(voxels), labels] += 1
    found, share = most_likely(ids, weights)
    assert np.array_equal(found, counts.argmax(axis=1))
    np.testing.assert_allclose(weights.sum(axis=1), rounds)
    assert (share >= counts.max(axis=1) / rounds - 1e-6).all()


def test_colours_of_classes_differ() -> None:
    colors = {class_color(number) for number in range(40)}
    assert len(colors) == 40
    assert class_color(0) == (128, 128, 128)


def test_classes_are_kept_in_ply_files(tmp_path: Path) -> None:
    mesh = fly(TsdfVolume(TsdfConfig(semantic=True)), flight(2)).extract_mesh()
    write_ply(tmp_path / "m.ply", mesh, {2: "wet  sand", 1: "Fels"})
    back = read_ply(tmp_path / "m.ply")
    assert np.array_equal(back.class_ids, mesh.class_ids)  # type: ignore[arg-type]
    assert np.array_equal(back.class_probabilities, mesh.class_probabilities)  # type: ignore[arg-type]
    np.testing.assert_allclose(back.vertices_m, mesh.vertices_m, atol=1e-5)
    assert read_class_names(tmp_path / "m.ply") == {1: "Fels", 2: "wet sand"}
