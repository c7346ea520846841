"""The ground of a stage as triangles that rays can hit."""

from __future__ import annotations

import numpy as np

from oaisys_core.private.embree import blenders_embree
from oaisys_core.raycast.open3d_bvh import BvhBuilder
from oaisys_core.raycast.triangles import HeightFieldTarget, TriangleTarget
from oaisys_core.scene import HeightField, Scene
from oaisys_core.types import TriangleMesh

LARGE_TRIANGLES = 6_000_000
"""Grounds of so many triangles use Blender's Embree, if loaded: Open3D's casts half as fast again
with the same results, but builds on one thread."""


def ground_mesh(scene: Scene) -> TriangleMesh:
    """Return the ground's triangles, without ids."""
    return TriangleMesh(scene.ground.vertices_m().astype(np.float64), scene.ground.triangles())


def ground_target(
    scene: Scene, ground: TriangleMesh | None
) -> tuple[TriangleMesh | None, TriangleTarget]:
    """Return the ground's ray target, and its mesh unless the scene's own has the same values."""
    mesh = ground_mesh(scene)
    if isinstance(scene.ground, HeightField) and (ground is None or _is_same(ground, mesh)):
        return None, HeightFieldTarget(scene.ground, mesh, _bvh_builder(mesh))
    mesh = ground or mesh
    return mesh, TriangleTarget([mesh], _bvh_builder(mesh))


def _is_same(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two meshes have the same vertices and triangles."""
    arrays = (one.vertices_m, other.vertices_m), (one.triangles, other.triangles)
    return all(np.array_equal(*each) for each in arrays)


def _bvh_builder(ground: TriangleMesh) -> BvhBuilder | None:
    embree = blenders_embree() if len(ground.triangles) >= LARGE_TRIANGLES else None
    return None if embree is None else embree.mesh
