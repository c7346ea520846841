"""How rays hit triangle meshes: which triangle first, and where.

Embree (Open3D's, unless another one is given) finds the triangle in float32. The distance to the
triangle's plane is then computed in float64, so that it is accurate at any range.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.open3d_bvh import BvhBuilder, Open3DBvh, TriangleBvh
from oaisys_core.raycast.targets.ground_shade import GroundShade
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT, RayCone, RayTarget
from oaisys_core.raycast.view import take_rows
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray, TriangleMesh, merge_meshes

PLANE_TOLERANCE = 1e-3
"""If the distances to plane and triangle differ by a larger share, the triangle is edge-on or has
no area, and Embree's distance is kept."""


class TriangleTarget(RayTarget):
    """Triangle meshes, whose triangles count through all meshes in their order."""

    def __init__(
        self,
        meshes: Sequence[TriangleMesh],
        builder: BvhBuilder | None = None,
        origin_m: FloatArray | None = None,
    ) -> None:
        """Prepare a BVH of meshes.

        Args:
            meshes: The meshes; missing ids count as 0.
            builder: Builds the BVH; None: Open3D.
            origin_m: (3,) where float32 is most precise; None: in the middle.
        """
        meshes = [mesh for mesh in meshes if len(mesh.triangles)]
        self._instance_ids = _instance_ids(meshes)
        self._bvh: TriangleBvh | None = None
        self.top_m = -np.inf
        if not meshes:
            return
        # A single mesh is not copied: grounds have millions of triangles.
        bare = [TriangleMesh(mesh.vertices_m, mesh.triangles) for mesh in meshes]
        soup = merge_meshes(bare) if len(bare) > 1 else bare[0]
        low_m, high_m = soup.vertices_m.min(axis=0), soup.vertices_m.max(axis=0)
        self.top_m = float(high_m[2])
        self._origin_m: FloatArray = (low_m + high_m) / 2 if origin_m is None else origin_m
        self._keep(soup)
        self._bvh = (builder or Open3DBvh)(soup.vertices_m - self._origin_m, soup.triangles)

    def prepare(self) -> None:
        """Build the BVH now rather than at the first cast."""
        if self._bvh is not None:
            self._bvh.prepare()

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        shape = directions.shape[:-1]
        if self._bvh is None:
            return np.full(shape, np.inf), np.full(shape, NO_ELEMENT, dtype=np.int64)
        local_m = np.asarray(origins_m, dtype=np.float64) - self._origin_m
        of_rays = local_m if local_m.ndim == 1 else local_m.reshape(-1, 3)
        rays = directions.reshape(-1, 3)
        coarse, triangles = self._bvh.first(of_rays, rays)
        distances, elements = coarse.astype(np.float64), triangles.astype(np.int64)
        is_hit = np.isfinite(coarse)
        # A slice is not copied.
        hit: Any = slice(None) if is_hit.all() else np.flatnonzero(is_hit)
        if not isinstance(hit, slice):
            elements[~is_hit] = NO_ELEMENT
        corners, normals = self._planes(elements[hit])
        origins = of_rays if of_rays.ndim == 1 else of_rays[hit]
        distances[hit] = exact_distances(distances[hit], corners, normals, origins, rays[hit])
        return distances.reshape(shape), elements.reshape(shape)

    def occludes(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """See `RayTarget`."""
        if self._bvh is None:
            return np.zeros(len(directions), np.bool_)
        return self._bvh.occludes(origins_m - self._origin_m, directions)

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        ids = np.zeros(elements.shape, np.uint32)
        if self._instance_ids is None:
            return ids
        hit = elements != NO_ELEMENT
        ids[hit] = self._instance_ids[elements[hit]]
        return ids

    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        return unit(self._planes(elements)[1])

    def _planes(self, triangle_ids: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return the (N, 3) first corners and (N, 3) normals, of any length, of triangles."""
        a, b, c = (each - self._origin_m for each in self._corners(triangle_ids))
        b -= a
        c -= a
        return a, _cross(b, c)

    def _keep(self, mesh: TriangleMesh) -> None:
        """Keep what `_corners` needs of all triangles."""
        self._vertices_m, self._triangles = mesh.vertices_m, mesh.triangles

    def _corners(self, triangle_ids: NDArray[np.int64]) -> Iterator[FloatArray]:
        """Yield the (N, 3) first, second and third corners of triangles, in ``map``."""
        for corners in self._triangles.take(triangle_ids, axis=0).T:
            yield self._vertices_m.take(corners, axis=0)


class HeightFieldTarget(TriangleTarget):
    """A height field, whose triangles' corners are computed from its elevations when needed.

    For millions of triangles, these take a twelfth of the memory that vertices and indices take.
    """

    def __init__(
        self, ground: HeightField, mesh: TriangleMesh, builder: BvhBuilder | None = None
    ) -> None:
        """Prepare a BVH of a height field's mesh, which is not kept; see `TriangleTarget`."""
        self._elevation_m = ground.elevation_m.astype(np.float32, copy=False)
        self._y_m, self._x_m = ground.grid_m()
        self._shade = GroundShade(ground)
        super().__init__([mesh], builder)

    def occludes(
        self, origins_m: FloatArray, directions: FloatArray, cone: RayCone | None = None
    ) -> NDArray[np.bool_]:
        """See `RayTarget`; rays of a cone that the ground cannot hide are not even cast."""
        if cone is None:
            return super().occludes(origins_m, directions)
        found = np.zeros(len(directions), np.bool_)
        rays = np.flatnonzero(self._shade.may_hide(origins_m, cone))
        if len(rays):
            some = take_rows(origins_m, rays), take_rows(directions, rays)
            found[rays] = super().occludes(*some)
        return found

    def _keep(self, mesh: TriangleMesh) -> None:
        """Keep the grid as seen from the origin, and its steps."""
        self._x_m = self._x_m.astype(np.float64) - self._origin_m[0]
        self._y_m = self._y_m.astype(np.float64) - self._origin_m[1]
        self._step_x_m, self._step_y_m = np.diff(self._x_m), np.diff(self._y_m)

    def _planes(self, triangle_ids: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """See `TriangleTarget`; the same products, but for those that are 0 along a grid's axes."""
        width = len(self._x_m)
        cells = triangle_ids >> 1
        row = cells // (width - 1)
        col = cells - row * (width - 1)
        is_upper = triangle_ids & 1
        # See `HeightField.triangles`.
        first = cells + row
        second, third = first + 1 + is_upper * width, first + (width + 1) - is_upper
        corners, normals = np.empty((2, 3, len(cells)))
        corners[0], corners[1] = self._x_m.take(col), self._y_m.take(row)
        corners[2] = self._height_m(first)
        dx, dy = self._step_x_m.take(col), self._step_y_m.take(row)
        second_dz, third_dz = (self._height_m(each) - corners[2] for each in (second, third))
        np.multiply(dx, dy, out=normals[2])
        np.subtract(is_upper * (dy * third_dz), second_dz * dy, out=normals[0])
        np.subtract((1 - is_upper) * (second_dz * dx), dx * third_dz, out=normals[1])
        return corners.T, normals.T

    def _height_m(self, places: NDArray[np.int64]) -> FloatArray:
        """Return (N,) elevations, less the origin's, of vertices by their places in the grid."""
        height_m = self._elevation_m.reshape(-1).take(places).astype(np.float64)
        height_m -= self._origin_m[2]
        return height_m


def exact_distances(
    coarse: FloatArray,
    corners: FloatArray,
    normals: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Return (N,) float64 distances to the planes of triangles that Embree found.

    Args:
        coarse: (N,) Embree's float32 distances.
        corners, normals: (N, 3) one corner and the normal, of any length, of each triangle.
        origins, directions: (N, 3) rays in the same frame; origins may be (3,).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        to_plane = _dot(normals, corners - origins) / _dot(normals, directions)
        trusted = np.abs(to_plane - coarse) <= PLANE_TOLERANCE * coarse
    return np.where(trusted, to_plane, coarse)


def unit(vectors: FloatArray) -> FloatArray:
    """Return (N, 3) vectors normalised to length 1; zero vectors stay zero."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (N, 3) cross products; `numpy.cross` makes more copies."""
    product = np.empty_like(a)
    product[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    product[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    product[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    # In the order in which einsum adds three products, so that depth is the same to the bit.
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 2] * b[:, 2] + a[:, 1] * b[:, 1])


def _instance_ids(meshes: Sequence[TriangleMesh]) -> NDArray[np.uint32] | None:
    """Return the instance id of each triangle, 0 where a mesh has none; None if no mesh has any."""
    if all(mesh.instance_ids is None for mesh in meshes):
        return None
    ids = [np.empty(0, np.uint32)]
    for mesh in meshes:
        zeros = np.zeros(len(mesh.triangles), np.uint32)
        ids.append(zeros if mesh.instance_ids is None else mesh.instance_ids)
    return np.concatenate(ids, dtype=np.uint32)
