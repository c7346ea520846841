"""Meshes of broken rock."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.rock_faces import (
    DEPTH,
    GRID,
    OUT,
    bare_and_ledges,
    make_rock_face,
)
from oaisys_core.scene import MeshPrototype

SEEDS = range(8)


def heights(seed: int) -> np.ndarray:
    vertices = make_rock_face("face", np.random.default_rng(seed)).vertices_m
    return vertices[:, 2].reshape(GRID, GRID)


def test_a_face_is_one_surface_of_a_metre_with_one_open_edge() -> None:
    for seed in SEEDS:
        face = make_rock_face("face", np.random.default_rng(seed))
        mesh = trimesh.Trimesh(face.vertices_m, face.triangles, process=False)
        np.testing.assert_allclose(mesh.extents[:2], 1.0)
        once = trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)
        assert len(once) == 4 * (GRID - 1)
        assert len(mesh.split(only_watertight=False)) == 1
        # From outside, all triangles run counter-clockwise.
        assert mesh.face_normals[:, 2].min() > 0


def test_its_edge_lies_in_the_wall_and_its_middle_stands_out() -> None:
    for seed in SEEDS:
        z = heights(seed)
        edge = np.concatenate((z[0], z[-1], z[:, 0], z[:, -1]))
        assert edge.max() < -0.4
        assert edge.min() > -2 * DEPTH
        middle = z[GRID // 3 : -GRID // 3, GRID // 3 : -GRID // 3]
        assert 0.4 * OUT < middle.mean() < 1.6 * OUT


def test_beds_and_joints_are_steps_between_flat_blocks() -> None:
    # Most of the surface is nearly flat; a few cells hold steps of centimetres.
    rises = []
    for seed in SEEDS:
        middle = heights(seed)[10:-10, 10:-10]
        rises.append(np.abs(np.diff(middle, axis=0)).ravel())
    rise = np.concatenate(rises)
    assert np.quantile(rise, 0.5) < 0.012
    assert np.quantile(rise, 0.97) > 3 * np.quantile(rise, 0.5)
    assert rise.max() > 0.05


def test_a_seed_always_gives_the_same_face_and_another_seed_another_one() -> None:
    assert heights(1).tobytes() == heights(1).tobytes()
    assert np.abs(heights(1) - heights(2)).mean() > 0.01


def corners_of(mesh: MeshPrototype) -> NDArray[np.float32]:
    return mesh.vertices_m[mesh.triangles]


@pytest.mark.parametrize("seed", range(4))
def test_bare_rock_and_ledges_are_the_whole_face(seed: int) -> None:
    face = make_rock_face("face", np.random.default_rng(seed))
    parts = bare_and_ledges(face)
    together = np.concatenate([corners_of(each) for each in parts]).reshape(-1, 9)
    whole = corners_of(face).reshape(-1, 9)
    np.testing.assert_array_equal(np.sort(together, axis=0), np.sort(whole, axis=0))
    assert len(np.unique(together, axis=0)) == len(whole)


def test_ledges_are_level_in_a_wall_and_bare_rock_is_steep() -> None:
    """In a wall of 60 degrees, in the mean over their area."""
    up = np.array((0.0, np.sin(np.radians(60)), np.cos(np.radians(60))))
    face = make_rock_face("face", np.random.default_rng(1))
    slopes_deg = []
    for part in bare_and_ledges(face):
        corners = corners_of(part).astype(float)
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(doubled, axis=1)
        slope_deg = np.degrees(np.arccos(np.clip(doubled @ up / area, -1, 1)))
        slopes_deg.append(float(np.average(slope_deg, weights=area)))
    assert slopes_deg[0] > 55
    assert slopes_deg[1] < 40
