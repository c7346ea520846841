"""Rays at meshes that stand in the world many times, without a copy of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.backend.raycast.embree import Embree
from oaisys_core.backend.raycast.instance_arrays import Crowd, Finder, Shapes, Standing, turned
from oaisys_core.backend.raycast.instance_boxes import BoxFinder
from oaisys_core.backend.raycast.instance_trees import TreeFinder
from oaisys_core.backend.raycast.triangles import NO_TRIANGLE, surface_height_m, unit
from oaisys_core.backend.raycast.visible_pixels import in_sight
from oaisys_core.scene import PlacedCamera, merge_meshes
from oaisys_core.types import FloatArray, TriangleMesh


class InstanceCaster:
    """Casts rays at placements, with the same results as a `RayCaster` over their `mesh`.

    Triangles are counted as if the instances' meshes were laid one after another.

    Attributes:
        low_m, high_m: (3,) corners of the box around them; infinite and reversed around nothing.
    """

    def __init__(
        self, standing: Sequence[Standing], shapes: Shapes, embree: Embree | None = None
    ) -> None:
        """Take over placements; without ``embree``, boxes are searched, ten times as long."""
        self._standing = [each for each in standing if each.triangle_count]
        self.low_m: FloatArray = np.full(3, np.inf)
        self.high_m: FloatArray = np.full(3, -np.inf)
        if not self._standing:
            return
        self._crowd = Crowd(self._standing, shapes)
        self.low_m = self._crowd.low_m.min(axis=0)
        self.high_m = self._crowd.high_m.max(axis=0)
        self._finder: Finder = (
            BoxFinder(self._crowd) if embree is None else TreeFinder(self._crowd, embree)
        )

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayCaster.intersect`; what lies beyond (...) ``limits`` need not be found.

        ``origins_m`` are (3,) for all rays, or (..., 3) outside of all instances' boxes.
        """
        shape = directions.shape[:-1]
        best = np.full(shape, np.inf).ravel() if limits is None else limits.astype(float).ravel()
        found = np.full(best.shape, NO_TRIANGLE, dtype=np.int64)
        if self._standing:
            self._finder.find(origins_m, directions.reshape(-1, 3), best, found)
        best[found == NO_TRIANGLE] = np.inf
        return best.reshape(shape), found.reshape(shape)

    def in_sight(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """Return (H, W) where a camera without distortion may see any of them; None: anywhere."""
        if not self._standing:
            pinhole = camera.intrinsics
            return np.zeros((pinhole.height_px, pinhole.width_px), np.bool_)
        return in_sight(camera, self._crowd.low_m, self._crowd.high_m)

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN where there is nothing."""
        return surface_height_m(self, xy_m)

    def instance_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance of each triangle id, 0 for `NO_TRIANGLE`."""
        ids = np.zeros(triangle_ids.shape, np.uint32)
        hit = triangle_ids != NO_TRIANGLE
        if hit.any():
            ids[hit] = self._crowd.instance_ids[self._crowd.instances_of(triangle_ids[hit])]
        return ids

    def normals_of(self, triangle_ids: NDArray[np.int64]) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) triangle ids; 0 for triangles without area."""
        crowd = self._crowd
        instances = crowd.instances_of(triangle_ids)
        local = triangle_ids - crowd.first[instances]
        normals = np.empty((len(triangle_ids), 3))
        for group, rows in crowd.by_group(instances):
            normals[rows] = crowd.shapes[group].planes[1][local[rows]]
        return unit(turned(crowd.T_map_object[instances, :3, :3], unit(normals)))

    def mesh(self) -> TriangleMesh:
        """Return the triangles of all instances, with ids."""
        return merge_meshes([each.mesh() for each in self._standing])
