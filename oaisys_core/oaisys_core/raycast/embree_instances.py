"""Rays at instances by the Embree library that comes with Blender."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.private.embree import INVALID_ID, Embree
from oaisys_core.raycast.instances import InstanceTarget, keep_nearest, matvec
from oaisys_core.raycast.prototype_meshes import PlacedPrototype
from oaisys_core.raycast.targets.ray_target import RayCone
from oaisys_core.raycast.triangles import exact_distances
from oaisys_core.types import FloatArray


class EmbreeInstanceTarget(InstanceTarget):
    """Instances by Embree, which finds triangles in float32; distances are refined in float64."""

    def __init__(self, placed: Sequence[PlacedPrototype], embree: Embree) -> None:
        """Concatenate at least one placement; each has at least one triangle."""
        super().__init__(placed)
        self._origin_m = (self.low_m.min(axis=0) + self.high_m.max(axis=0)) / 2
        ends = np.cumsum(np.bincount(self.groups, minlength=len(self.meshes)))
        self._first_instance = np.concatenate(([0], ends))
        T_local_object = self.T_map_object.copy()
        T_local_object[:, :3, 3] -= self._origin_m
        scenes = [
            embree.keep_mesh(mesh, mesh.vertices_m, mesh.prototype.triangles)
            for mesh in self.meshes
        ]
        self._scene = embree.instances(scenes, np.split(T_local_object, ends[:-1]))
        meshes = list(dict.fromkeys(self.meshes))
        starts = np.cumsum([0, *(mesh.triangle_count for mesh in meshes)])
        self._first_plane = starts[[meshes.index(mesh) for mesh in self.meshes]]
        self._corners = np.concatenate([mesh.planes[0] for mesh in meshes])
        self._normals = np.concatenate([mesh.planes[1] for mesh in meshes])
        for mesh, first, end in zip(meshes, starts[:-1], starts[1:], strict=True):
            # Views, so that planes are held once.
            mesh.planes = self._corners[first:end], self._normals[first:end]

    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """See `InstanceTarget.find`."""
        # Rounded up, so that a hit exactly at its limit is found.
        limits = np.nextafter(best.astype(np.float32), np.float32(np.inf))
        coarse, ids = self._scene.nearest(origins_m - self._origin_m, directions, limits)
        rays = np.flatnonzero(ids[0] != INVALID_ID)
        groups, numbers, triangles = ids[:, rays].astype(np.int64)
        instances = self._first_instance[groups] + numbers
        planes = self._first_plane[groups] + triangles
        T = self.T_object_map[instances]
        origins = np.broadcast_to(origins_m, directions.shape)[rays]
        distances = exact_distances(
            coarse[rays].astype(np.float64),
            self._corners[planes],
            self._normals[planes],
            matvec(T[:, :3, :3], origins) + T[:, :3, 3],
            matvec(T[:, :3, :3], directions[rays]),
        )
        keep_nearest(best, found, rays, distances, self.first[instances] + triangles)

    def occludes(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """See `RayTarget`."""
        if self.has_cut_outs.any():
            return super().occludes(origins_m, directions)
        return self._scene.occludes(origins_m - self._origin_m, directions)
