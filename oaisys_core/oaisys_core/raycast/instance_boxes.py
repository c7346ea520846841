"""Ray casting at instances without Blender's Embree, by their bounding boxes.

Open3D finds which boxes each ray enters; the ray is then cast at the prototype of each of these
instances, in the instance's own frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.instances import InstanceTarget, keep_nearest, matvec
from oaisys_core.raycast.objects.visible_boxes import BOX_CORNERS
from oaisys_core.raycast.open3d_bvh import open3d_scene
from oaisys_core.raycast.prototype_meshes import PlacedPrototype
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT
from oaisys_core.system.ending.interruption import stop_if_unwanted
from oaisys_core.types import FloatArray

BOX_MARGIN = 0.01
"""Share of its size by which a box is enlarged, so that rounding makes no ray miss its instance."""

RAYS_AT_A_TIME = 10_000
"""Bounds the memory for pairs of ray and box: a ray along the ground may enter thousands of boxes.
"""

BOX_TRIANGLES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)),
        *((0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)),
        *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.int32,
)
"""Two triangles per face, faces ordered by lower and upper x, y, z."""


class BoxInstanceTarget(InstanceTarget):
    """Instances, found by their boxes."""

    def __init__(self, placed: Sequence[PlacedPrototype]) -> None:
        """Concatenate at least one placement; each has at least one triangle."""
        super().__init__(placed)
        reach_m = max(np.abs(self.low_m).max(), np.abs(self.high_m).max())
        size_m = (self.high_m - self.low_m).max(axis=1, keepdims=True)
        margin_m = BOX_MARGIN * size_m + 1e-6 * reach_m
        self._box_low_m, self._box_high_m = self.low_m - margin_m, self.high_m + margin_m
        self._origin_m = (self._box_low_m.min(axis=0) + self._box_high_m.max(axis=0)) / 2
        low_m, high_m = self._box_low_m[:, None], self._box_high_m[:, None]
        vertices = np.where(BOX_CORNERS == 0, low_m, high_m) - self._origin_m
        first = (np.arange(len(vertices), dtype=np.int32) * 8)[:, None, None]
        self._boxes = open3d_scene(vertices.reshape(-1, 3), (BOX_TRIANGLES + first).reshape(-1, 3))

    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """See `InstanceTarget.find`."""
        for first in range(0, len(directions), RAYS_AT_A_TIME):
            some = slice(first, first + RAYS_AT_A_TIME)
            origins = origins_m if origins_m.ndim == 1 else origins_m[some]
            self._find(origins, directions[some], best[some], found[some])

    def _find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Find the hits of some rays: try their nearest boxes first, in rounds of 1, 2, 4, …."""
        stop_if_unwanted()
        rays, instances, enters = self._candidates(origins_m, directions, best)
        origins = np.broadcast_to(origins_m, (*directions.shape[:-1], 3)).reshape(-1, 3)
        ranks = np.arange(len(rays)) - np.searchsorted(rays, rays)
        first, many = 0, 1
        while first <= ranks.max(initial=-1):
            stop_if_unwanted()
            tried = (ranks >= first) & (ranks < first + many) & (enters < best[rays])
            pairs = (rays[tried], instances[tried], enters[tried])
            self._try(pairs, origins, directions, best, found)
            first, many = first + many, 2 * many

    def _candidates(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return rays, the instances whose boxes they enter, and distances to these boxes.

        The pairs are sorted by ray, then by distance.
        """
        import open3d as o3d

        rays_in_box = np.empty((len(directions), 6), np.float32)
        rays_in_box[:, :3] = origins_m.reshape(-1, 3) - self._origin_m
        rays_in_box[:, 3:] = directions
        met = self._boxes.list_intersections(o3d.core.Tensor(rays_in_box))
        rays, triangles, enters = (
            met[name].numpy() for name in ("ray_ids", "primitive_ids", "t_hit")
        )
        instances, corner = np.divmod(triangles.astype(np.int64), len(BOX_TRIANGLES))
        axis, is_upper = corner // 4, corner // 2 % 2 == 1
        into = (directions.ravel()[3 * rays.astype(np.int64) + axis] < 0) == is_upper
        near = into & (enters < limits[rays])
        rays, instances = rays[near].astype(np.int64), instances[near]
        enters = enters[near].astype(np.float64)
        rays_inside, instances_inside = self._inside(origins_m, len(directions))
        rays = np.concatenate((rays_inside, rays))
        instances = np.concatenate((instances_inside, instances))
        enters = np.concatenate((np.zeros(len(rays_inside)), enters))
        order = np.lexsort((enters, rays))
        return rays[order], instances[order], enters[order]

    def _inside(
        self, origins_m: FloatArray, count: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return pairs of a ray and an instance in whose box the ray begins."""
        origins = origins_m.reshape(-1, 3)
        near = (self._box_low_m <= origins.max(axis=0)) & (origins.min(axis=0) <= self._box_high_m)
        instances = np.flatnonzero(near.all(axis=1))
        low_m, high_m = self._box_low_m[instances], self._box_high_m[instances]
        around = (low_m <= origins[:, None]) & (origins[:, None] <= high_m)
        rays, which = np.nonzero(np.broadcast_to(around.all(axis=2), (count, len(instances))))
        return rays, instances[which]

    def _try(
        self,
        pairs: tuple[NDArray[np.int64], NDArray[np.int64], FloatArray],
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Cast each ray at its instance, in the instance's frame, and keep the nearer hits."""
        rays, instances, enters = pairs
        entries_m = origins_m[rays] + enters[:, None] * directions[rays]
        T = self.T_object_map[instances]
        origins = matvec(T[:, :3, :3], entries_m) + T[:, :3, 3]
        local_directions = matvec(T[:, :3, :3], directions[rays])
        distances = np.empty(len(rays))
        elements = np.empty(len(rays), np.int64)
        for group, rows in self.by_group(instances):
            distances[rows], elements[rows] = self.meshes[group].target.intersect(
                origins[rows], local_directions[rows]
            )
        hit = elements != NO_ELEMENT
        rays, distances = rays[hit], (enters + distances)[hit]
        elements = elements[hit] + self.first[instances[hit]]
        farthest_first = np.argsort(-distances, kind="stable")
        of_hits = (each[farthest_first] for each in (rays, distances, elements))
        keep_nearest(best, found, *of_hits)
