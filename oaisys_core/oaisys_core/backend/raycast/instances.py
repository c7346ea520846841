"""Ray casting at instances, without a copy of the mesh for each of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.backend.raycast.embree import INVALID_ID, Embree
from oaisys_core.backend.raycast.instance_arrays import (
    InstanceArrays,
    InstanceFinder,
    PlacedPrototype,
    PrototypeMeshes,
    keep_nearest,
    matvec,
)
from oaisys_core.backend.raycast.instance_boxes import BoxInstanceFinder
from oaisys_core.backend.raycast.triangles import NO_TRIANGLE, refined, surface_height_m, unit
from oaisys_core.backend.raycast.visible_pixels import visible_pixels
from oaisys_core.scene import PlacedCamera, merge_meshes
from oaisys_core.types import FloatArray, TriangleMesh


class InstanceCaster:
    """Casts rays at placements, with the same results as a `RayCaster` over their `mesh`.

    Triangle ids count through the meshes of all instances, one after the other.

    Attributes:
        low_m, high_m: (3,) corners of the bounding box; ``+inf`` and ``-inf`` without instances.
    """

    def __init__(
        self,
        placed: Sequence[PlacedPrototype],
        shapes: PrototypeMeshes,
        embree: Embree | None = None,
    ) -> None:
        """Take over placements; without ``embree``, casting takes ten times as long."""
        self._placed_prototypes = [each for each in placed if each.triangle_count]
        self.low_m: FloatArray = np.full(3, np.inf)
        self.high_m: FloatArray = np.full(3, -np.inf)
        if not self._placed_prototypes:
            return
        self._arrays = InstanceArrays(self._placed_prototypes, shapes)
        self.low_m = self._arrays.low_m.min(axis=0)
        self.high_m = self._arrays.high_m.max(axis=0)
        self._finder: InstanceFinder = (
            BoxInstanceFinder(self._arrays)
            if embree is None
            else EmbreeInstanceFinder(self._arrays, embree)
        )

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayCaster.intersect`; hits beyond (...) ``limits`` may be left out.

        ``origins_m`` are (3,) for all rays, or (..., 3) outside the instances' bounding boxes.
        """
        shape = directions.shape[:-1]
        best = np.full(shape, np.inf).ravel() if limits is None else limits.astype(float).ravel()
        found = np.full(best.shape, NO_TRIANGLE, dtype=np.int64)
        if self._placed_prototypes:
            self._finder.find(origins_m, directions.reshape(-1, 3), best, found)
        best[found == NO_TRIANGLE] = np.inf
        return best.reshape(shape), found.reshape(shape)

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """Return (H, W) which pixels may see an instance, see `visible_pixels`; None: any may."""
        if not self._placed_prototypes:
            pinhole = camera.intrinsics
            return np.zeros((pinhole.height_px, pinhole.width_px), np.bool_)
        return visible_pixels(camera, self._arrays.low_m, self._arrays.high_m)

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """See the function `surface_height_m`."""
        return surface_height_m(self, xy_m)

    def instance_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance id of each triangle id, 0 for `NO_TRIANGLE`."""
        ids = np.zeros(triangle_ids.shape, np.uint32)
        hit = triangle_ids != NO_TRIANGLE
        if hit.any():
            ids[hit] = self._arrays.instance_ids[self._arrays.instances_of(triangle_ids[hit])]
        return ids

    def normals_of(self, triangle_ids: NDArray[np.int64]) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) triangle ids; 0 for triangles without area."""
        arrays = self._arrays
        instances = arrays.instances_of(triangle_ids)
        local = triangle_ids - arrays.first[instances]
        normals = np.empty((len(triangle_ids), 3))
        for group, rows in arrays.by_group(instances):
            normals[rows] = arrays.shapes[group].planes[1][local[rows]]
        return unit(matvec(arrays.T_map_object[instances, :3, :3], unit(normals)))

    def mesh(self) -> TriangleMesh:
        """Return one mesh of all instances, with ids per triangle."""
        return merge_meshes([each.mesh() for each in self._placed_prototypes])


class EmbreeInstanceFinder:
    """See `InstanceFinder`; Embree finds triangles in float32, distances are refined in float64."""

    def __init__(self, arrays: InstanceArrays, embree: Embree) -> None:
        self._arrays = arrays
        self._origin_m = (arrays.low_m.min(axis=0) + arrays.high_m.max(axis=0)) / 2
        ends = np.cumsum(np.bincount(arrays.groups, minlength=len(arrays.shapes)))
        self._first_instance = np.concatenate(([0], ends))
        T_local_object = arrays.T_map_object.copy()
        T_local_object[:, :3, 3] -= self._origin_m
        poses = np.split(T_local_object, ends[:-1])
        self._scene = embree.instances([shape.tree(embree) for shape in arrays.shapes], poses)
        shapes = list(dict.fromkeys(arrays.shapes))
        starts = np.cumsum([0, *(shape.triangle_count for shape in shapes)])
        self._first_plane = starts[[shapes.index(shape) for shape in arrays.shapes]]
        self._corners = np.concatenate([shape.planes[0] for shape in shapes])
        self._normals = np.concatenate([shape.planes[1] for shape in shapes])

    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """See `InstanceFinder.find`."""
        # Rounded up, so that a hit exactly at its limit is found.
        limits = np.nextafter(best.astype(np.float32), np.float32(np.inf))
        coarse, ids = self._scene.nearest(origins_m - self._origin_m, directions, limits)
        rays = np.flatnonzero(ids[0] != INVALID_ID)
        groups, numbers, triangles = ids[:, rays].astype(np.int64)
        instances = self._first_instance[groups] + numbers
        planes = self._first_plane[groups] + triangles
        T = self._arrays.T_object_map[instances]
        origins = np.broadcast_to(origins_m, directions.shape)[rays]
        distances = refined(
            coarse[rays].astype(np.float64),
            self._corners[planes],
            self._normals[planes],
            matvec(T[:, :3, :3], origins) + T[:, :3, 3],
            matvec(T[:, :3, :3], directions[rays]),
        )
        keep_nearest(best, found, rays, distances, self._arrays.first[instances] + triangles)
