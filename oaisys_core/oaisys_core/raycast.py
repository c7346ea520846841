"""Exact views of triangle meshes: which triangle each ray meets first, and where.

Embree (through Open3D) finds the triangle in float32; where the ray meets that triangle's plane
is then computed in float64, so that accuracy does not depend on how far from the origin, or in
which bounding volumes, a triangle lies.

Where ``bpy`` is used in the same process it must have been imported first: both bring a library
of the same name, and Blender's is the newer one. Open3D is imported when it is first needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.types import FloatArray, PinholeIntrinsics, TriangleMesh

NO_TRIANGLE = -1
"""Triangle id of a ray that meets nothing."""

PLANE_TOLERANCE = 1e-3
"""Relative distance by which the plane's intersection may differ from Embree's; beyond it the
triangle is seen edge-on or has no area, and Embree's distance stands."""


@dataclass(frozen=True)
class CameraHits:
    """What each pixel of a camera sees, at the pixel's centre.

    Attributes:
        depth_m: (H, W) float32 planar z, ``+inf`` where nothing was hit.
        triangle_ids: (H, W) int64 index over all meshes in their order, `NO_TRIANGLE` for none.
        semantic_ids: (H, W) uint16 of the triangle, 0 for none.
        instance_ids: (H, W) uint32 of the triangle, 0 for none.
        points_m: (H, W, 3) float64 in ``map``; not finite where nothing was hit.
    """

    depth_m: NDArray[np.float32]
    triangle_ids: NDArray[np.int64]
    semantic_ids: NDArray[np.uint16]
    instance_ids: NDArray[np.uint32]
    points_m: FloatArray


class RayCaster:
    """Casts rays at a fixed set of triangle meshes."""

    def __init__(self, meshes: Sequence[TriangleMesh]) -> None:
        """Build the search structure over all triangles of ``meshes`` (coordinates in ``map``).

        Ids that a mesh does not have count as 0.
        """
        counts = [len(mesh.triangles) for mesh in meshes]
        self._semantic_ids = _per_triangle([m.semantic_ids for m in meshes], counts, np.uint16)
        self._instance_ids = _per_triangle([m.instance_ids for m in meshes], counts, np.uint32)
        points = [m.vertices_m for m in meshes if len(m.vertices_m)]
        low = np.min([p.min(axis=0) for p in points], axis=0) if points else np.zeros(3)
        high = np.max([p.max(axis=0) for p in points], axis=0) if points else np.zeros(3)
        self._origin_m: FloatArray = np.asarray((low + high) / 2, dtype=np.float64)
        self._top_m = float(high[2])
        self._normals: FloatArray = np.empty((sum(counts), 3))
        self._embree: Any = _new_scene() if sum(counts) else None
        first = 0
        for mesh, count in zip(meshes, counts, strict=True):
            if count:
                self._add(mesh, self._normals[first : first + count])
            first += count

    def _add(self, mesh: TriangleMesh, normals: FloatArray) -> None:
        import open3d as o3d

        local = np.subtract(mesh.vertices_m, self._origin_m, dtype=np.float64)
        self._embree.add_triangles(
            o3d.core.Tensor(np.ascontiguousarray(local, dtype=np.float32)),
            o3d.core.Tensor(np.ascontiguousarray(mesh.triangles, dtype=np.uint32)),
        )

    def cast(self, T_map_camera: FloatArray, intrinsics: PinholeIntrinsics) -> CameraHits:
        """Return what a camera at ``T_map_camera`` (optical frame) sees at its pixel centres."""
        directions = pixel_rays(intrinsics) @ T_map_camera[:3, :3].T
        depth_m, triangle_ids = self.intersect(T_map_camera[:3, 3], directions)
        return CameraHits(
            depth_m=depth_m.astype(np.float32),
            triangle_ids=triangle_ids,
            semantic_ids=self.semantic_ids_of(triangle_ids),
            instance_ids=self.instance_ids_of(triangle_ids),
            points_m=T_map_camera[:3, 3] + depth_m[..., None] * directions,
        )
