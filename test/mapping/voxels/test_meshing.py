"""Meshes of a volume: closed, oriented, and independent of when they are extracted."""

import numpy as np
import pytest
import trimesh
from synthetic_views import (
    CAMERA,
    camera_at,
    flight,
    fly,
    same_mesh,
    sphere_depth_m,
)

from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_mapping.voxels.marching_cubes import triangle_table


def test_meshes_are_closed_and_face_outwards() -> None:
    volume = TsdfVolume(TsdfConfig(truncation_voxels=8.0))
    for axis in range(3):
        for sign in (-1.0, 1.0):
            eye_m = np.array([0.013, 0.017, 0.011])
            eye_m[axis] = 5 * sign
            T = camera_at(tuple(eye_m), (0, 0, 0))
            volume.integrate(sphere_depth_m(T, 1.5), None, CAMERA, T)
    mesh = volume.extract_mesh()
    theirs = trimesh.Trimesh(mesh.vertices_m, mesh.triangles, process=False)
    assert theirs.is_watertight
    assert theirs.is_winding_consistent
    # Positive where triangles face outwards, and the sphere's own.
    assert theirs.volume == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=0.03)
    away_m = np.linalg.norm(mesh.vertices_m, axis=1) - 1.5
    assert np.sqrt(np.square(away_m).mean()) < 0.02


def test_the_triangle_table_uses_exactly_the_crossed_edges() -> None:
    triangles, first, end = triangle_table()
    assert (first[0], first[255]) == (end[0], end[255])
    for cube in range(256):
        used = set(triangles[first[cube] : end[cube]].ravel().tolist())
        corners = [(c, a) for c in range(8) for a in range(3) if not c >> a & 1]
        crossed = {
            number
            for number, (corner, axis) in enumerate(corners)
            if (cube >> corner & 1) != (cube >> (corner | 1 << axis) & 1)
        }
        assert used == crossed


def test_an_incremental_mesh_equals_one_extracted_at_once() -> None:
    kept, anew = TsdfVolume(TsdfConfig(semantic=True)), TsdfVolume(TsdfConfig(semantic=True))
    for T in flight(5):
        fly(kept, [T])
        kept.extract_mesh()
    for T in flight(5):
        fly(anew, [T])
    assert len(anew.extract_mesh().triangles) > 10_000
    assert same_mesh(kept.extract_mesh(), anew.extract_mesh())
    kept.forget_mesh()
    assert same_mesh(kept.extract_mesh(), anew.extract_mesh())


def test_vertices_are_shared_across_blocks() -> None:
    mesh = fly(TsdfVolume(), flight(3)).extract_mesh()
    assert len(np.unique(mesh.vertices_m, axis=0)) == len(mesh.vertices_m)
    assert len(np.unique(mesh.triangles)) == len(mesh.vertices_m)
    # A surface without holes has about twice as many triangles as vertices.
    assert 1.9 < len(mesh.triangles) / len(mesh.vertices_m) < 2.0
