"""Instances of meshes as arrays, shared by the ways to cast rays at them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.embree import Embree, EmbreeScene
from oaisys_core.backend.raycast.triangles import RayCaster
from oaisys_core.backend.raycast.visible_pixels import BOX_CORNERS
from oaisys_core.scene import MeshPrototype, Placement, id_of_level
from oaisys_core.types import FloatArray, TriangleMesh


def merged_instances(
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


class PrototypeMesh:
    """A prototype's mesh in its own frame; its ray casting structures are built on first use."""

    def __init__(self, prototype: MeshPrototype) -> None:
        self.prototype = prototype
        self.vertices_m: FloatArray = prototype.vertices_m.astype(np.float64)
        self._bvh: EmbreeScene | None = None

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return len(self.prototype.triangles)

    @cached_property
    def caster(self) -> RayCaster:
        """Open3D's ray caster for this mesh."""
        return RayCaster([TriangleMesh(self.vertices_m, self.prototype.triangles)])

    @cached_property
    def planes(self) -> tuple[FloatArray, FloatArray]:
        """(T, 3) first corners of the triangles, and (T, 3) normals of any length."""
        a, b, c = (self.vertices_m[corner] for corner in self.prototype.triangles.T)
        return a, np.cross(b - a, c - a)

    def tree(self, embree: Embree) -> EmbreeScene:
        """Return Embree's scene of this mesh."""
        if self._bvh is None:
            self._bvh = embree.mesh(self.vertices_m, self.prototype.triangles)
        return self._bvh


class PrototypeMeshes:
    """The `PrototypeMesh` of each prototype in use."""

    def __init__(self) -> None:
        self._shapes: dict[int, PrototypeMesh] = {}

    def of(self, prototype: MeshPrototype) -> PrototypeMesh:
        """Return the mesh of a prototype."""
        if id(prototype) not in self._shapes:
            self._shapes[id(prototype)] = PrototypeMesh(prototype)
        return self._shapes[id(prototype)]

    def keep_only(self, prototypes: Sequence[MeshPrototype]) -> None:
        """Drop the meshes of all other prototypes."""
        wanted = {id(prototype) for prototype in prototypes}
        self._shapes = {key: kept for key, kept in self._shapes.items() if key in wanted}


@dataclass(frozen=True)
class PlacedPrototype:
    """A placement and its prototype."""

    prototype: MeshPrototype
    placement: Placement

    def is_same(self, other: PlacedPrototype) -> bool:
        """Return whether the other has the identical placement and prototype objects."""
        return self.placement is other.placement and self.prototype is other.prototype

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all instances."""
        return len(self.prototype.triangles) * len(self.placement.T_map_object)

    def mesh(self) -> TriangleMesh:
        """Return one mesh of all instances, with ids per triangle."""
        prototype, placement = self.prototype, self.placement
        mesh = TriangleMesh(prototype.vertices_m.astype(np.float64), prototype.triangles)
        poses, ids = placement.T_map_object, placement.instance_ids
        return merged_instances(mesh, poses, placement.semantic_ids, ids)


class InstanceArrays:
    """The N instances of some placements, concatenated.

    Triangle ids count through the meshes of all instances, one after the other.

    Attributes:
        shapes: Mesh of each placement.
        groups: (N,) int, index of each instance's placement.
        first: (N + 1,) int64, first triangle id of each instance, then the number of triangles.
        instance_ids: (N,) uint32.
        T_map_object, T_object_map: (N, 4, 4).
        low_m, high_m: (N, 3) corners of the instances' bounding boxes.
    """

    def __init__(self, placed: Sequence[PlacedPrototype], shapes: PrototypeMeshes) -> None:
        """Concatenate at least one placement; each has at least one instance."""
        placements = [each.placement for each in placed]
        counts = [len(placement.T_map_object) for placement in placements]
        self.shapes = [shapes.of(each.prototype) for each in placed]
        self.groups = np.repeat(np.arange(len(placed)), counts)
        sizes = np.repeat([shape.triangle_count for shape in self.shapes], counts)
        self.first = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.instance_ids = np.concatenate([each.instance_ids for each in placements])
        self.T_map_object = np.concatenate([each.T_map_object for each in placements])
        self.T_object_map = _inverse(self.T_map_object)
        self.low_m, self.high_m = self._bounds()

    def instances_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the index of each triangle's instance."""
        return np.searchsorted(self.first, triangle_ids, side="right") - 1

    def by_group(self, instances: NDArray[np.intp]) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Yield the index of each placement among ``instances``, and the rows that belong to it."""
        groups = self.groups[instances]
        order = np.argsort(groups, kind="stable")
        starts = np.searchsorted(groups[order], np.arange(len(self.shapes) + 1))
        for group in np.flatnonzero(np.diff(starts)).tolist():
            yield group, order[starts[group] : starts[group + 1]]

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        low_m = np.empty((len(self.groups), 3))
        high_m = np.empty((len(self.groups), 3))
        for group, shape in enumerate(self.shapes):
            rows = self.groups == group
            T = self.T_map_object[rows]
            low, high = shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)
            corners = low + BOX_CORNERS * (high - low)
            points = np.einsum("nij,vj->nvi", T[:, :3, :3], corners) + T[:, None, :3, 3]
            low_m[rows], high_m[rows] = points.min(axis=1), points.max(axis=1)
        return low_m, high_m


class InstanceFinder(Protocol):
    """Finds the first hits of rays at instances."""

    def find(
        self,
        origins_m: FloatArray,
        directions: FloatArray,
        best: FloatArray,
        found: NDArray[np.int64],
    ) -> None:
        """Replace distances and triangle ids, in place, where rays hit something nearer.

        Args:
            origins_m: (3,) for all rays, or (R, 3) outside the instances' bounding boxes.
            directions: (R, 3) of any length.
            best: (R,) distances so far, in units of the directions' lengths.
            found: (R,) triangle ids so far.
        """


def keep_nearest(
    best: FloatArray,
    found: NDArray[np.int64],
    rays: NDArray[np.int64],
    distances: FloatArray,
    triangle_ids: NDArray[np.int64],
) -> None:
    """Replace distances and triangle ids, in place, where (N,) rays hit something nearer.

    If a ray occurs more than once in ``rays``, its last occurrence counts.
    """
    nearer = distances < best[rays]
    best[rays[nearer]] = distances[nearer]
    found[rays[nearer]] = triangle_ids[nearer]


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
    return np.asarray(np.einsum("nij,nj->ni", R, vectors))
