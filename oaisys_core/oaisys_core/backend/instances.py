"""Rays at meshes that stand in the world many times, without a copy of each.

Embree, as Open3D gives it, knows no instances. Here a first structure holds one box around each
instance; the rays that meet a box are then cast at that instance's prototype, in its own frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.raycast import NO_TRIANGLE, RayCaster, embree_scene, surface_height_m, unit
from oaisys_core.scene import MeshPrototype, Placement, id_of_level, merge_meshes
from oaisys_core.types import FloatArray, TriangleMesh

MERGED_TRIANGLES = 12_000_000
"""Triangles up to which one structure over copies of all instances is taken.

It is ten times as fast to cast at and more, but takes 0.7 s and 0.1 GB per million triangles to
build (two cores): 100,000 pebbles of 80 triangles take 6 s and 0.8 GB, as boxes 0.6 s and 0.1 GB.
"""

BOX_MARGIN = 0.01
"""Share of a box's size by which it is enlarged, so that rays do not slip past it by rounding, and
start outside of what it holds."""

BOX_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)

BOX_TRIANGLES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)),
        *((0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)),
        *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.int32,
)
"""Two per face: lower and upper x, then y, then z."""


def placed(
    mesh: TriangleMesh,
    T_map_object: FloatArray,
    semantic_ids: Sequence[int],
    instance_ids: NDArray[Any],
) -> TriangleMesh:
    """Return one mesh of (N,) instances of ``mesh``, each at its own (N, 4, 4) pose."""
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


class LocalCasters:
    """One structure per prototype, in its own frame, kept as long as the prototype is used."""

    def __init__(self) -> None:
        self._casters: dict[int, tuple[MeshPrototype, RayCaster]] = {}

    def of(self, prototype: MeshPrototype) -> RayCaster:
        """Return the structure of a prototype, built when first asked for."""
        if id(prototype) not in self._casters:
            mesh = TriangleMesh(prototype.vertices_m.astype(np.float64), prototype.triangles)
            self._casters[id(prototype)] = (prototype, RayCaster([mesh]))
        return self._casters[id(prototype)][1]

    def keep_only(self, prototypes: Sequence[MeshPrototype]) -> None:
        """Drop the structures of all others."""
        wanted = {id(prototype) for prototype in prototypes}
        self._casters = {key: kept for key, kept in self._casters.items() if key in wanted}


@dataclass(frozen=True)
class Standing:
    """A placement together with the prototype that it names."""

    prototype: MeshPrototype
    placement: Placement

    def is_same(self, other: Standing) -> bool:
        """Return whether the other is the very same placement of the very same prototype."""
        return self.placement is other.placement and self.prototype is other.prototype

    @property
    def triangle_count(self) -> int:
        """Triangles of all its instances."""
        return len(self.prototype.triangles) * len(self.placement.T_map_object)

    def mesh(self) -> TriangleMesh:
        """Return the triangles of all instances, with ids."""
        prototype, placement = self.prototype, self.placement
        mesh = TriangleMesh(prototype.vertices_m.astype(np.float64), prototype.triangles)
        poses, ids = placement.T_map_object, placement.instance_ids
        return placed(mesh, poses, placement.semantic_ids, ids)


class InstanceCaster:
    """Casts rays at placements, with the same results as a `RayCaster` over their `mesh`.

    Triangles are counted as if the instances' meshes were laid one after another.

    Attributes:
        low_m, high_m: (3,) corners of the box around them; infinite and reversed around nothing.
    """

    def __init__(self, standing: Sequence[Standing], casters: LocalCasters) -> None:
        standing = [each for each in standing if each.triangle_count]
        counts = [len(each.placement.T_map_object) for each in standing]
        sizes = [len(each.prototype.triangles) for each in standing]
        self._standing = standing
        self._casters = [casters.of(each.prototype) for each in standing]
        self._group = np.repeat(np.arange(len(standing)), counts)
        self._first = np.concatenate(([0], np.cumsum(np.repeat(sizes, counts)))).astype(np.int64)
        self.low_m: FloatArray = np.full(3, np.inf)
        self.high_m: FloatArray = np.full(3, -np.inf)
        if not standing:
            return
        self._instance_ids = np.concatenate([each.placement.instance_ids for each in standing])
        self._T_map_object = np.concatenate([each.placement.T_map_object for each in standing])
        self._T_object_map = _inverse(self._T_map_object)
        self._low_m, self._high_m = self._bounds()
        self.low_m, self.high_m = self._low_m.min(axis=0), self._high_m.max(axis=0)
        self._origin_m = (self.low_m + self.high_m) / 2
        low_m, high_m = self._low_m[:, None], self._high_m[:, None]
        vertices = np.where(BOX_CORNERS == 0, low_m, high_m) - self._origin_m
        first = (np.arange(len(vertices), dtype=np.int32) * 8)[:, None, None]
        self._boxes = embree_scene(vertices.reshape(-1, 3), (BOX_TRIANGLES + first).reshape(-1, 3))

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayCaster.intersect`; what lies beyond (...) ``limits`` need not be found.

        ``origins_m`` are (3,) for all rays, or (..., 3) outside of all instances' boxes.
        """
        shape = directions.shape[:-1]
        best = np.full(shape, np.inf).ravel() if limits is None else limits.astype(float).ravel()
        found = np.full(best.shape, NO_TRIANGLE, dtype=np.int64)
        if len(self._group):
            self._search(origins_m, directions.reshape(-1, 3), best, found)
        best[found == NO_TRIANGLE] = np.inf
        return best.reshape(shape), found.reshape(shape)

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN where there is nothing."""
        return surface_height_m(self, xy_m)

    def instance_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance of each triangle id, 0 for `NO_TRIANGLE`."""
        ids = np.zeros(triangle_ids.shape, np.uint32)
        hit = triangle_ids != NO_TRIANGLE
        if hit.any():
            ids[hit] = self._instance_ids[self._instances_of(triangle_ids[hit])]
        return ids

    def normals_of(self, triangle_ids: NDArray[np.int64]) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) triangle ids; 0 for triangles without area."""
        instances = self._instances_of(triangle_ids)
        local = triangle_ids - self._first[instances]
        normals = np.empty((len(triangle_ids), 3))
        for group, rows in self._by_group(instances):
            R = self._T_map_object[instances[rows], :3, :3]
            normals[rows] = _turned(R, self._casters[group].normals_of(local[rows]))
        return unit(normals)

    def mesh(self) -> TriangleMesh:
        """Return the triangles of all instances, with ids."""
        return merge_meshes([each.mesh() for each in self._standing])

    def _by_group(self, instances: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Give each placement, and the rows of those of ``instances`` that belong to it."""
        groups = self._group[instances]
        order = np.argsort(groups, kind="stable")
        starts = np.searchsorted(groups[order], np.arange(len(self._casters) + 1))
        for group in np.flatnonzero(np.diff(starts)).tolist():
            yield group, order[starts[group] : starts[group + 1]]

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return (N, 3) lower and upper corners of boxes around the instances, with a margin."""
        low_m = np.empty((len(self._group), 3))
        high_m = np.empty((len(self._group), 3))
        for group, caster in enumerate(self._casters):
            rows = self._group == group
            T = self._T_map_object[rows]
            corners = caster.low_m + BOX_CORNERS * (caster.high_m - caster.low_m)
            points = np.einsum("nij,vj->nvi", T[:, :3, :3], corners) + T[:, None, :3, 3]
            low_m[rows], high_m[rows] = points.min(axis=1), points.max(axis=1)
        reach_m = np.abs(np.concatenate((low_m, high_m))).max()
        margin_m = BOX_MARGIN * (high_m - low_m).max(axis=1, keepdims=True) + 1e-6 * reach_m
        return low_m - margin_m, high_m + margin_m

    def _instances_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.intp]:
        return np.searchsorted(self._first, triangle_ids, side="right") - 1

    def _search(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Cast (R, 3) rays at the instances whose boxes they meet, from the nearest box on.

        More boxes are tried in each round, as the rays that are left need ever more of them.
        """
        rays, instances, enters = self._candidates(origins_m, directions, best)
        origins = np.broadcast_to(origins_m, (*directions.shape[:-1], 3)).reshape(-1, 3)
        ranks = np.arange(len(rays)) - np.searchsorted(rays, rays)
        first, many = 0, 1
        while first <= ranks.max(initial=-1):
            tried = (ranks >= first) & (ranks < first + many) & (enters < best[rays])
            pairs = (rays[tried], instances[tried], enters[tried])
            self._try(pairs, origins, directions, best, found)
            first, many = first + many, 2 * many

    def _candidates(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return pairs of ray and instance with the distance to its box, by ray, nearest first."""
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
        if origins_m.ndim == 1:
            around = (self._low_m <= origins_m) & (origins_m <= self._high_m)
            inside = np.flatnonzero(around.all(axis=1))
            rays = np.concatenate((np.repeat(np.arange(len(directions)), len(inside)), rays))
            instances = np.concatenate((np.tile(inside, len(directions)), instances))
            enters = np.concatenate((np.zeros(len(inside) * len(directions)), enters))
        order = np.lexsort((enters, rays))
        return rays[order], instances[order], enters[order]

    def _try(
        self,
        pairs: tuple[NDArray[np.int64], NDArray[np.int64], FloatArray],
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Cast rays at one instance each, in its frame and from its box on; keep what is nearer."""
        rays, instances, enters = pairs
        entries_m = origins_m[rays] + enters[:, None] * directions[rays]
        T = self._T_object_map[instances]
        origins = _turned(T[:, :3, :3], entries_m) + T[:, :3, 3]
        local_directions = _turned(T[:, :3, :3], directions[rays])
        distances = np.empty(len(rays))
        triangle_ids = np.empty(len(rays), np.int64)
        for group, rows in self._by_group(instances):
            distances[rows], triangle_ids[rows] = self._casters[group].intersect(
                origins[rows], local_directions[rows]
            )
        hit = triangle_ids != NO_TRIANGLE
        rays, distances = rays[hit], (enters + distances)[hit]
        triangle_ids = triangle_ids[hit] + self._first[instances[hit]]
        farthest_first = np.argsort(-distances, kind="stable")
        rays, distances = rays[farthest_first], distances[farthest_first]
        nearer = distances < best[rays]
        best[rays[nearer]] = distances[nearer]
        found[rays[nearer]] = triangle_ids[farthest_first][nearer]


def _inverse(T: FloatArray) -> FloatArray:
    """Return the inverses of (N, 4, 4) affine poses, whose parts may be scaled and sheared.

    LAPACK, as NumPy calls it for each matrix, takes 20 to 130 µs apiece.
    """
    inverse = np.zeros_like(T)
    columns = T[:, :3, :3].transpose(2, 0, 1)
    for row in range(3):
        inverse[:, row, :3] = np.cross(columns[(row + 1) % 3], columns[(row + 2) % 3])
    inverse[:, :3, :3] /= np.einsum("ni,ni->n", inverse[:, 0, :3], columns[0])[:, None, None]
    inverse[:, :3, 3] = -_turned(inverse[:, :3, :3], T[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse


def _turned(R: NDArray[np.float64], vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", R, vectors))
