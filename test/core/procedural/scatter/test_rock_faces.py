"""Meshes of broken rock."""

from __future__ import annotations

import numpy as np
import trimesh

from oaisys_core.procedural.scatter.rock_faces import DEPTH, GRID, OUT, make_rock_face

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
