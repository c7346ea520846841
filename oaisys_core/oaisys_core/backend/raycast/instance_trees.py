"""Instances found by Embree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.embree import NOTHING, Embree
from oaisys_core.backend.raycast.instance_arrays import Crowd, keep_nearer, turned
from oaisys_core.backend.raycast.triangles import refined
from oaisys_core.types import FloatArray


class TreeFinder:
    """See `Finder`.

    Embree finds the triangle in float32; how far it is, is then computed in float64.
    """

    def __init__(self, crowd: Crowd, embree: Embree) -> None:
        self._crowd = crowd
        self._origin_m = (crowd.low_m.min(axis=0) + crowd.high_m.max(axis=0)) / 2
        ends = np.cumsum(np.bincount(crowd.groups, minlength=len(crowd.shapes)))
        self._first_instance = np.concatenate(([0], ends))
        T_local_object = crowd.T_map_object.copy()
        T_local_object[:, :3, 3] -= self._origin_m
        poses = np.split(T_local_object, ends[:-1])
        self._scene = embree.instances([shape.tree(embree) for shape in crowd.shapes], poses)
        shapes = list(dict.fromkeys(crowd.shapes))
        starts = np.cumsum([0, *(shape.triangle_count for shape in shapes)])
        self._first_plane = starts[[shapes.index(shape) for shape in crowd.shapes]]
        self._corners = np.concatenate([shape.planes[0] for shape in shapes])
        self._normals = np.concatenate([shape.planes[1] for shape in shapes])

    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """See `Finder.find`."""
        # What is as far as a limit is found, too, before it is rounded.
        limits = np.nextafter(best.astype(np.float32), np.float32(np.inf))
        coarse, ids = self._scene.nearest(origins_m - self._origin_m, directions, limits)
        rays = np.flatnonzero(ids[0] != NOTHING)
        groups, numbers, triangles = ids[:, rays].astype(np.int64)
        instances = self._first_instance[groups] + numbers
        planes = self._first_plane[groups] + triangles
        T = self._crowd.T_object_map[instances]
        origins = np.broadcast_to(origins_m, directions.shape)[rays]
        distances = refined(
            coarse[rays].astype(np.float64),
            self._corners[planes],
            self._normals[planes],
            turned(T[:, :3, :3], origins) + T[:, :3, 3],
            turned(T[:, :3, :3], directions[rays]),
        )
        keep_nearer(best, found, rays, distances, self._crowd.first[instances] + triangles)
