"""Meshes of prototypes, and the places of their instances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.mesh_textures import MeshTextures
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.scene import MeshPrototype, Placement, id_of_level
from oaisys_core.scene.objects import ids_in_images
from oaisys_core.types import FloatArray, TriangleMesh


class PrototypeMesh:
    """A prototype's mesh in its own frame; what rays need of it is computed on first use."""

    def __init__(self, prototype: MeshPrototype) -> None:
        self.prototype = prototype
        self.textures = MeshTextures(prototype)

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return len(self.prototype.triangles)

    @cached_property
    def vertices_m(self) -> FloatArray:
        """(V, 3) vertices."""
        return self.prototype.vertices_m.astype(np.float64)

    @cached_property
    def target(self) -> TriangleTarget:
        """The mesh as a ray target, by Open3D."""
        return TriangleTarget([TriangleMesh(self.vertices_m, self.prototype.triangles)])

    @cached_property
    def planes(self) -> tuple[FloatArray, FloatArray]:
        """(T, 3) first corners of the triangles, and (T, 3) normals of any length."""
        a, b, c = (self.vertices_m[corner] for corner in self.prototype.triangles.T)
        return a, np.cross(b - a, c - a)


@dataclass(frozen=True)
class PlacedPrototype:
    """A placement and the mesh of its prototype."""

    mesh: PrototypeMesh
    placement: Placement

    def is_same(self, other: PlacedPrototype) -> bool:
        """Return whether the other has the identical placement and mesh objects."""
        return self.placement is other.placement and self.mesh is other.mesh

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all instances."""
        return self.mesh.triangle_count * len(self.placement.T_map_object)

    def merge(self) -> TriangleMesh:
        """Return one mesh of all instances, with ids per triangle as images show them."""
        mesh = TriangleMesh(self.mesh.vertices_m, self.mesh.prototype.triangles)
        placement = self.placement
        ids = placement.semantic_ids, ids_in_images(placement.instance_ids)
        return merge_instances(mesh, placement.T_map_object, *ids)


def merge_instances(
    mesh: TriangleMesh,
    T_map_object: FloatArray,
    semantic_ids: Sequence[int],
    instance_ids: NDArray[Any],
) -> TriangleMesh:
    """Return one mesh of N copies of ``mesh`` at (N, 4, 4) poses, with ids per triangle."""
    count, vertices = len(T_map_object), len(mesh.vertices_m)
    points = np.einsum("nij,vj->nvi", T_map_object[:, :3, :3], mesh.vertices_m)
    points += T_map_object[:, None, :3, 3]
    first = (np.arange(count, dtype=np.int32) * vertices)[:, None, None]
    triangles = (mesh.triangles + first).reshape(-1, 3)
    return TriangleMesh(
        vertices_m=points.reshape(-1, 3),
        triangles=triangles,
        semantic_ids=np.full(len(triangles), id_of_level(semantic_ids, 0), dtype=np.uint16),
        instance_ids=np.repeat(instance_ids.astype(np.uint32), len(mesh.triangles)),
    )
