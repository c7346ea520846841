"""What rays can hit, and how they hit triangle meshes: which triangle first, and where.

Embree (Open3D's, unless another one is given) finds the triangle in float32. The distance to the
triangle's plane is then computed in float64, so that it is accurate at any range.

Open3D is imported on first use; see `oaisys_core.private.open3d_import` for ``bpy`` in the same
process.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.scene import HeightField, PlacedCamera
from oaisys_core.types import FloatArray, TriangleMesh, merge_meshes

NO_ELEMENT = -1
"""Element of a ray that hits nothing."""

PLANE_TOLERANCE = 1e-3
"""If the distances to plane and triangle differ by a larger share, the triangle is edge-on or has
no area, and Embree's distance is kept."""


class RayTarget(ABC):
    """A part of a scene that rays can hit.

    Its elements, numbered from 0, are its triangles, or the whole of an exact solid.

    Attributes:
        top_m: Height that no point of it exceeds; ``-inf``: it is empty.
        has_images: Whether any element has an image of its own.
    """

    top_m: float
    has_images: bool = False

    def visible_pixels(self, camera: PlacedCamera) -> NDArray[np.bool_] | None:
        """Return (H, W) which pixels' rays may hit it; None: all."""
        return None

    @abstractmethod
    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the distance and the element of each ray's first hit.

        Args:
            origins_m: (..., 3) in ``map``, or (3,) for all rays.
            directions: (..., 3) of any length.
            limits: (...) distances; hits beyond them may be left out.

        Returns:
            (...) float64 distances in units of the directions' lengths, ``+inf`` for a miss, and
            (...) int64 elements, `NO_ELEMENT` for a miss.
        """

    @abstractmethod
    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance id of each element, 0 for `NO_ELEMENT`."""

    @abstractmethod
    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) elements at (N, 3) points on them.

        Those of triangles without area are 0.
        """

    def albedo_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) linear albedo of (N,) elements at (N, 3) points on them.

        NaN where an element has no image of its own.
        """
        return np.full(points_m.shape, np.nan)

    def triangles_of(self, elements: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the index of each element among the triangles of its object's own mesh."""
        return elements

    def occludes(self, origins_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Return (R,) whether (R, 3) rays from (R, 3) origins hit it anywhere."""
        return np.isfinite(self.intersect(origins_m, directions)[0])

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """Return the (N,) topmost heights at (N, 2) points, NaN where there is nothing."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        above_m = self.top_m + 1.0
        if not np.isfinite(above_m):
            return np.full(len(xy), np.nan)
        origins = np.column_stack((xy, np.full(len(xy), above_m)))
        down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
        distance_m, _ = self.intersect(origins, down)
        return np.where(np.isfinite(distance_m), above_m - distance_m, np.nan)


class TriangleBvh(Protocol):
    """A bounding volume hierarchy (BVH) of triangles."""

    def first(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return the (R,) distances and triangle indices of the first hits of (R, 3) rays.

        ``origins`` may be (3,) for all rays. Distances are in units of the directions' lengths,
        ``+inf`` for a miss.
        """

    def occludes(self, origins: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Return (R,) whether (R, 3) rays hit any triangle."""

    def prepare(self) -> None:
        """Build it now rather than at the first cast."""


BvhBuilder = Callable[[FloatArray, NDArray[np.int32]], TriangleBvh]
"""Builds a BVH of (V, 3) vertices and (T, 3) triangles."""


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
        hit: Any = np.flatnonzero(np.isfinite(distances))
        if len(hit) == len(rays):
            # A slice is not copied.
            hit = slice(None)
        else:
            elements[~np.isfinite(distances)] = NO_ELEMENT
        corners, normals = self._planes(elements[hit])
        origins = of_rays if of_rays.ndim == 1 else of_rays[hit]
        distances[hit] = exact_distances(distances[hit], corners, normals, origins, rays[hit])
        return distances.reshape(shape), elements.reshape(shape)

    def occludes(self, origins_m: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """See `RayTarget`."""
        if self._bvh is None:
            return np.zeros(len(directions), np.bool_)
        return self._bvh.occludes(origins_m - self._origin_m, directions)

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        hit = elements != NO_ELEMENT
        ids = np.zeros(elements.shape, np.uint32)
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
        super().__init__([mesh], builder)

    def _keep(self, mesh: TriangleMesh) -> None:
        pass

    def _corners(self, triangle_ids: NDArray[np.int64]) -> Iterator[FloatArray]:
        width = len(self._x_m)
        cells = triangle_ids >> 1
        row = cells // (width - 1)
        col = cells - row * (width - 1)
        is_upper = triangle_ids & 1
        elevation_m = self._elevation_m.reshape(-1)
        # See `HeightField.triangles`.
        for rows, cols in ((row, col), (row + is_upper, col + 1), (row + 1, col + 1 - is_upper)):
            places = np.empty((3, len(rows)))
            places[0], places[1] = self._x_m.take(cols), self._y_m.take(rows)
            places[2] = elevation_m.take(rows * width + cols)
            yield places.T


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


class Open3DBvh:
    """Open3D's BVH, see `TriangleBvh`; Open3D builds it at the first cast."""

    def __init__(self, vertices_m: FloatArray, triangles: NDArray[np.int32]) -> None:
        self._scene = open3d_scene(vertices_m, triangles)

    def first(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """See `TriangleBvh.first`."""
        import open3d as o3d

        rays = _open3d_rays(origins, directions)
        found = self._scene.cast_rays(o3d.core.Tensor(rays))
        return found["t_hit"].numpy(), found["primitive_ids"].numpy()

    def first_places(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
        """Return what `first` does, and the (R, 2) weights of each second and third corner."""
        import open3d as o3d

        rays = _open3d_rays(origins, directions)
        found = self._scene.cast_rays(o3d.core.Tensor(rays))
        return tuple(found[name].numpy() for name in ("t_hit", "primitive_ids", "primitive_uvs"))

    def occludes(self, origins: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """See `TriangleBvh.occludes`."""
        import open3d as o3d

        rays = _open3d_rays(origins, directions)
        return np.asarray(self._scene.test_occlusions(o3d.core.Tensor(rays)).numpy())

    def prepare(self) -> None:
        """See `TriangleBvh.prepare`."""
        self.first(np.zeros(3), np.zeros((1, 3)))


def _open3d_rays(origins: NDArray[Any], directions: NDArray[Any]) -> NDArray[np.float32]:
    """Return (R, 6) origins and directions; copied by component, which is thrice as fast."""
    rays = np.empty((len(directions), 6), dtype=np.float32)
    for axis in range(3):
        rays[:, axis], rays[:, 3 + axis] = origins[..., axis], directions[..., axis]
    return rays


def open3d_scene(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> Any:
    """Return Open3D's ray casting scene of (V, 3) vertices and (T, 3) triangles."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices_m.astype(np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return scene


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


def _instance_ids(meshes: Sequence[TriangleMesh]) -> NDArray[np.uint32]:
    """Return the instance id of each triangle of some meshes, 0 where a mesh has none."""
    if all(mesh.instance_ids is None for mesh in meshes):
        return np.broadcast_to(np.uint32(0), sum(len(mesh.triangles) for mesh in meshes))
    ids = [np.empty(0, np.uint32)]
    for mesh in meshes:
        zeros = np.zeros(len(mesh.triangles), np.uint32)
        ids.append(zeros if mesh.instance_ids is None else mesh.instance_ids)
    return np.concatenate(ids, dtype=np.uint32)
