"""Ray casting at instances of meshes, without a copy of the mesh for each of them.

The hits are found by `embree_instances`, or by `instance_boxes` without Blender's Embree.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.objects.visible_boxes import BOX_CORNERS, visible_pixels
from oaisys_core.raycast.prototype_meshes import PlacedPrototype
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT, RayTarget
from oaisys_core.raycast.triangles import exact_distances, unit
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray

MAX_VISIBLE_SHARE = 0.7
"""If instances may be visible in a larger share of the pixels, all rays are cast at them."""

MAX_LAYERS = 10_000
"""Of cut-outs that a ray may go through."""

BEYOND = 4e-7
"""How far behind a hole a ray goes on, as a share of the coordinates there: a few steps of the
float32 in which triangles are found."""


class InstanceTarget(RayTarget):
    """The N instances of some placements, with the same hits as one mesh of all of them.

    Elements count through the triangles of all instances, one after the other.

    Attributes:
        meshes: Mesh of each placement.
        groups: (N,) int, index of each instance's placement.
        first: (N + 1,) int64, first element of each instance, then the number of elements.
        instance_ids: (N,) uint32.
        T_map_object, T_object_map: (N, 4, 4).
        low_m, high_m: (N, 3) corners of the instances' bounding boxes.
        has_cut_outs: Of each placement, whether rays go through some of its triangles.
    """

    def __init__(self, placed: Sequence[PlacedPrototype]) -> None:
        """Concatenate at least one placement; each has at least one triangle."""
        placements = [each.placement for each in placed]
        counts = [len(placement.T_map_object) for placement in placements]
        self.meshes = [each.mesh for each in placed]
        self.groups = np.repeat(np.arange(len(placed)), counts)
        sizes = np.repeat([mesh.triangle_count for mesh in self.meshes], counts)
        self.first = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.instance_ids = np.concatenate([each.instance_ids for each in placements])
        self.T_map_object = np.concatenate([each.T_map_object for each in placements])
        self.T_object_map = _inverse(self.T_map_object)
        self.low_m, self.high_m = self._bounds()
        self.top_m = float(self.high_m[:, 2].max())
        self.has_cut_outs = np.array([mesh.textures.has_cut_outs for mesh in self.meshes])
        self.has_images = any(mesh.textures.has_any for mesh in self.meshes)

    @abstractmethod
    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Replace distances and elements, in place, where rays hit something nearer.

        Args:
            origins_m: (R, 3), or (3,) for all rays.
            directions: (R, 3) of any length.
            best: (R,) distances so far, in units of the directions' lengths.
            found: (R,) elements so far.
        """

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        shape = directions.shape[:-1]
        best = np.full(shape, np.inf).ravel() if limits is None else limits.astype(float).ravel()
        found = np.full(best.shape, NO_ELEMENT, dtype=np.int64)
        limits = best.copy()
        directions = directions.reshape(-1, 3)
        self.find(origins_m, directions, best, found)
        if self.has_cut_outs.any():
            self._pass_holes(origins_m, directions, limits, best, found)
        best[found == NO_ELEMENT] = np.inf
        return best.reshape(shape), found.reshape(shape)

    def _pass_holes(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        limits: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Replace hits in the holes of cut-outs, in place, by the first ones behind them."""
        rays = np.flatnonzero(found != NO_ELEMENT)
        origins_m = np.broadcast_to(origins_m, directions.shape)
        steps = np.ones(len(best))
        passed = np.zeros(len(best), np.bool_)
        for _ in range(MAX_LAYERS):
            points_m = origins_m[rays] + best[rays, None] * directions[rays]
            is_hole = ~self._is_solid(found[rays], points_m)
            rays, points_m = rays[is_hole], points_m[is_hole]
            if not len(rays):
                break
            passed[rays] = True
            reach_m = np.abs(points_m).max(axis=1) + np.abs(points_m - origins_m[rays]).max(axis=1)
            lengths_m = np.linalg.norm(directions[rays], axis=1)
            beyond = best[rays] + BEYOND * steps[rays] * reach_m / lengths_m
            rest = limits[rays] - beyond
            before, next_found = found[rays], np.full(len(rays), NO_ELEMENT, dtype=np.int64)
            starts_m = origins_m[rays] + beyond[:, None] * directions[rays]
            self.find(starts_m, directions[rays], rest, next_found)
            # The same triangle once more: the step was too short for its slope.
            steps[rays] = np.where(next_found == before, 2 * steps[rays], 1.0)
            best[rays], found[rays] = beyond + rest, next_found
            rays = rays[next_found != NO_ELEMENT]
        behind = np.flatnonzero(passed & (found != NO_ELEMENT))
        best[behind] = self._refine(
            best[behind], found[behind], origins_m[behind], directions[behind]
        )

    def _refine(
        self,
        distances: FloatArray,
        elements: NDArray[np.int64],
        origins_m: FloatArray,
        directions: FloatArray,
    ) -> FloatArray:
        """Return exact distances to the planes of elements, from the rays' own origins."""
        instances = self._instances_of(elements)
        triangles = elements - self.first[instances]
        T = self.T_object_map[instances]
        corners, normals = np.empty((2, len(elements), 3))
        for group, rows in self.by_group(instances):
            first, normal = self.meshes[group].planes
            corners[rows], normals[rows] = first[triangles[rows]], normal[triangles[rows]]
        origins = matvec(T[:, :3, :3], origins_m) + T[:, :3, 3]
        return exact_distances(
            distances, corners, normals, origins, matvec(T[:, :3, :3], directions)
        )

    def _is_solid(self, elements: NDArray[np.int64], points_m: FloatArray) -> NDArray[np.bool_]:
        """Return (N,) whether elements have a surface at (N, 3) points in ``map`` on them."""
        solid = np.ones(len(elements), np.bool_)
        instances = self._instances_of(elements)
        cut = np.flatnonzero(self.has_cut_outs[self.groups[instances]])
        for group, numbers in self.by_group(instances[cut]):
            rows = cut[numbers]
            triangles, points = self._in_objects(elements[rows], points_m[rows])
            solid[rows] = self.meshes[group].textures.is_solid(triangles, points)
        return solid

    def albedo_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        albedo = np.full(points_m.shape, np.nan)
        for group, rows in self.by_group(self._instances_of(elements)):
            textures = self.meshes[group].textures
            if textures.has_any:
                albedo[rows] = textures.albedo(*self._in_objects(elements[rows], points_m[rows]))
        return albedo

    def triangles_of(self, elements: NDArray[np.int64]) -> NDArray[np.int64]:
        """See `RayTarget`."""
        return elements - self.first[self._instances_of(elements)]

    def _in_objects(
        self, elements: NDArray[np.int64], points_m: FloatArray
    ) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the triangles of elements, and points in ``map`` in their objects' frames."""
        instances = self._instances_of(elements)
        T = self.T_object_map[instances]
        points = matvec(T[:, :3, :3], points_m) + T[:, :3, 3]
        return elements - self.first[instances], points

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """See `RayTarget`."""
        if not camera.intrinsics.is_rectilinear:
            return None
        found = visible_pixels(camera, self.low_m, self.high_m)
        if found is None or np.count_nonzero(found) > MAX_VISIBLE_SHARE * found.size:
            return None
        return found

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        ids = np.zeros(elements.shape, np.uint32)
        hit = elements != NO_ELEMENT
        ids[hit] = self.instance_ids[self._instances_of(elements[hit])]
        return ids

    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        instances = self._instances_of(elements)
        triangles = elements - self.first[instances]
        normals = np.empty((len(elements), 3))
        for group, rows in self.by_group(instances):
            normals[rows] = self.meshes[group].planes[1][triangles[rows]]
        return unit(matvec(self.T_map_object[instances, :3, :3], unit(normals)))

    def by_group(self, instances: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Yield the index of each placement among ``instances``, and the rows that belong to it."""
        groups = self.groups[instances]
        order = np.argsort(groups, kind="stable")
        starts = np.searchsorted(groups[order], np.arange(len(self.meshes) + 1))
        for group in np.flatnonzero(np.diff(starts)).tolist():
            yield group, order[starts[group] : starts[group + 1]]

    def _instances_of(self, elements: NDArray[np.int64]) -> NDArray[np.intp]:
        return np.searchsorted(self.first, elements, side="right") - 1

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        low_m = np.empty((len(self.groups), 3))
        high_m = np.empty((len(self.groups), 3))
        for group, mesh in enumerate(self.meshes):
            rows = self.groups == group
            T = self.T_map_object[rows]
            low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
            corners = low + BOX_CORNERS * (high - low)
            points = np.einsum("nij,vj->nvi", T[:, :3, :3], corners) + T[:, None, :3, 3]
            low_m[rows], high_m[rows] = points.min(axis=1), points.max(axis=1)
        return low_m, high_m


def keep_nearest(
    best: FloatArray,
    found: NDArray[np.int64],
    rays: NDArray[np.int64],
    distances: FloatArray,
    elements: NDArray[np.int64],
) -> None:
    """Replace distances and elements, in place, where (N,) rays hit something nearer.

    If a ray occurs more than once in ``rays``, its last occurrence counts.
    """
    nearer = distances < best[rays]
    best[rays[nearer]] = distances[nearer]
    found[rays[nearer]] = elements[nearer]


def _inverse(T: FloatArray) -> FloatArray:
    """Return the inverses of (N, 4, 4) affine transforms.

    The adjugate is a vectorised closed form; `numpy.linalg.inv` calls LAPACK once per matrix.
    """
    inverse = np.zeros_like(T)
    columns = T[:, :3, :3].transpose(2, 0, 1)
    for row in range(3):
        inverse[:, row, :3] = np.cross(columns[(row + 1) % 3], columns[(row + 2) % 3])
    inverse[:, :3, :3] /= np.einsum("ni,ni->n", inverse[:, 0, :3], columns[0])[:, None, None]
    inverse[:, :3, 3] = -matvec(inverse[:, :3, :3], T[:, :3, 3])
    inverse[:, 3, 3] = 1.0
    return inverse


def matvec(R: NDArray[np.float64], vectors: FloatArray) -> FloatArray:
    """Return (N, 3) products of (N, 3, 3) matrices and (N, 3) vectors."""
    # The order in which einsum adds depends on that of the vectors' components in memory.
    return np.asarray(np.einsum("nij,nj->ni", R, np.ascontiguousarray(vectors)))
