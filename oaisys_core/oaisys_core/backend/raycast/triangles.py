"""Ray casting at triangle meshes: which triangle each ray hits first, and where.

Embree (Open3D's, unless another one is given) finds the triangle in float32. The distance to the
triangle's plane is then computed in float64, so that it is accurate at any range.

Open3D is imported on first use; see `oaisys_core.native_libraries` for ``bpy`` in the same process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.scene import merge_meshes
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr, TriangleMesh

NO_TRIANGLE = -1
"""Triangle id of a ray that hits nothing."""

PLANE_TOLERANCE = 1e-3
"""If the distances to plane and triangle differ by a larger share, the triangle is edge-on or has
no area, and Embree's distance is kept."""


@dataclass(frozen=True, repr=False)
class CameraHits(ShortRepr):
    """What each pixel of a camera sees at its centre.

    Attributes:
        depth_m: (H, W) float32 planar z, ``+inf`` where nothing was hit.
        triangle_ids: (H, W) int64 index over all meshes in their order, `NO_TRIANGLE` for none.
        semantic_ids: (H, W) uint16, 0 for none.
        instance_ids: (H, W) uint32, 0 for none.
        points_m: (H, W, 3) float64 in ``map``, NaN where nothing was hit.
    """

    depth_m: NDArray[np.float32]
    triangle_ids: NDArray[np.int64]
    semantic_ids: NDArray[np.uint16]
    instance_ids: NDArray[np.uint32]
    points_m: FloatArray


class TriangleBvh(Protocol):
    """A bounding volume hierarchy (BVH) of triangles."""

    def first(
        self, origins: FloatArray, directions: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return the (R,) distances and triangle indices of the first hits of (R, 3) rays.

        ``origins`` may be (3,) for all rays. Distances are in units of the directions' lengths,
        ``+inf`` for a miss.
        """

    def prepare(self) -> None:
        """Build it now rather than at the first cast."""


BvhBuilder = Callable[[FloatArray, NDArray[np.int32]], TriangleBvh]
"""Builds a BVH of (V, 3) vertices and (T, 3) triangles."""


class RayCaster:
    """Casts rays at a fixed set of triangle meshes.

    Attributes:
        low_m, high_m: (3,) corners of the bounding box; ``+inf`` and ``-inf`` without triangles.
    """

    def __init__(self, meshes: Sequence[TriangleMesh], builder: BvhBuilder | None = None) -> None:
        """Prepare a BVH of ``meshes``, by Open3D without a ``builder``; missing ids count as 0."""
        meshes = [mesh for mesh in meshes if len(mesh.triangles)]
        counts = [len(mesh.triangles) for mesh in meshes]
        self._semantic_ids = _ids([m.semantic_ids for m in meshes], counts, np.uint16)
        self._instance_ids = _ids([m.instance_ids for m in meshes], counts, np.uint32)
        self._bvh: TriangleBvh | None = None
        self.low_m: FloatArray = np.full(3, np.inf)
        self.high_m: FloatArray = np.full(3, -np.inf)
        if not meshes:
            return
        soup = merge_meshes([TriangleMesh(m.vertices_m, m.triangles) for m in meshes])
        self.low_m, self.high_m = soup.vertices_m.min(axis=0), soup.vertices_m.max(axis=0)
        self._origin_m: FloatArray = (self.low_m + self.high_m) / 2
        self._local_m = soup.vertices_m - self._origin_m
        self._triangles = soup.triangles
        self._bvh = (builder or Open3DBvh)(self._local_m, self._triangles)

    def prepare(self) -> None:
        """Build the BVH now rather than at the first cast."""
        if self._bvh is not None:
            self._bvh.prepare()

    def cast(self, T_map_camera: FloatArray, intrinsics: PinholeIntrinsics) -> CameraHits:
        """Return the hits of a camera whose optical frame is at ``T_map_camera``."""
        directions = pixel_rays(intrinsics) @ T_map_camera[:3, :3].T
        depth_m, triangle_ids = self.intersect(T_map_camera[:3, 3], directions)
        with np.errstate(invalid="ignore"):
            points_m = T_map_camera[:3, 3] + depth_m[..., None] * directions
        points_m[triangle_ids == NO_TRIANGLE] = np.nan
        return CameraHits(
            depth_m=depth_m.astype(np.float32),
            triangle_ids=triangle_ids,
            semantic_ids=self.semantic_ids_of(triangle_ids),
            instance_ids=self.instance_ids_of(triangle_ids),
            points_m=points_m,
        )

    def surface_height_m(self, xy_m: ArrayLike) -> FloatArray:
        """See the function `surface_height_m`."""
        return surface_height_m(self, xy_m)

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the distance and the triangle of each ray's first hit.

        Args:
            origins_m: (..., 3) in ``map``, or (3,) for all rays.
            directions: (..., 3) of any length.

        Returns:
            (...) float64 distances in units of the directions' lengths, ``+inf`` for a miss, and
            (...) int64 triangle ids, `NO_TRIANGLE` for a miss.
        """
        shape = directions.shape[:-1]
        if self._bvh is None:
            return np.full(shape, np.inf), np.full(shape, NO_TRIANGLE, dtype=np.int64)
        local_m = np.asarray(origins_m, dtype=np.float64) - self._origin_m
        of_rays = local_m if local_m.ndim == 1 else local_m.reshape(-1, 3)
        coarse, triangles = self._bvh.first(of_rays, directions.reshape(-1, 3))
        distances = coarse.astype(np.float64).reshape(shape)
        hit = np.isfinite(distances)
        triangle_ids = np.where(hit, triangles.astype(np.int64).reshape(shape), NO_TRIANGLE)
        self._refine(distances, triangle_ids, hit, local_m, directions)
        return distances, triangle_ids

    def semantic_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint16]:
        """Return the semantic id of each triangle id, 0 for `NO_TRIANGLE`."""
        return _looked_up(self._semantic_ids, triangle_ids)

    def instance_ids_of(self, triangle_ids: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return the instance id of each triangle id, 0 for `NO_TRIANGLE`."""
        return _looked_up(self._instance_ids, triangle_ids)

    def normals_of(self, triangle_ids: NDArray[np.int64]) -> FloatArray:
        """Return the (N, 3) unit normals of (N,) triangle ids; 0 for triangles without area."""
        return unit(self._planes(triangle_ids)[1])

    def _planes(self, triangle_ids: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return the (N, 3) first corners and (N, 3) normals, of any length, of triangles."""
        corners = self._triangles.take(triangle_ids, axis=0)
        a, b, c = (self._local_m.take(corners[:, i], axis=0) for i in range(3))
        b -= a
        c -= a
        return a, _cross(b, c)

    def _refine(
        self,
        distances: FloatArray,
        triangle_ids: NDArray[np.int64],
        hit: NDArray[np.bool_],
        local_m: FloatArray,
        directions: FloatArray,
    ) -> None:
        """Replace Embree's float32 distances in place, see `refined`."""
        corners, normals = self._planes(triangle_ids[hit])
        origins = local_m if local_m.ndim == 1 else local_m[hit]
        distances[hit] = refined(distances[hit], corners, normals, origins, directions[hit])


class Caster(Protocol):
    """Anything that finds the first hits of rays.

    Attributes:
        low_m, high_m: (3,) corners of the bounding box; ``+inf`` and ``-inf`` without triangles.
    """

    low_m: FloatArray
    high_m: FloatArray

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayCaster.intersect`."""


def surface_height_m(caster: Caster, xy_m: ArrayLike) -> FloatArray:
    """Return the (N,) topmost heights at (N, 2) points, NaN where there is no triangle."""
    xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    above_m = float(caster.high_m[2]) + 1.0
    if not np.isfinite(above_m):
        return np.full(len(xy), np.nan)
    origins = np.column_stack((xy, np.full(len(xy), above_m)))
    down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
    distance_m, _ = caster.intersect(origins, down)
    return np.where(np.isfinite(distance_m), above_m - distance_m, np.nan)


def refined(
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

        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3], rays[:, 3:] = origins, directions
        found = self._scene.cast_rays(o3d.core.Tensor(rays))
        return found["t_hit"].numpy(), found["primitive_ids"].numpy()

    def prepare(self) -> None:
        """See `TriangleBvh.prepare`."""
        self.first(np.zeros(3), np.zeros((1, 3)))


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
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _ids(
    per_mesh: Sequence[NDArray[Any] | None], counts: Sequence[int], dtype: type[np.generic]
) -> NDArray[Any]:
    parts = [
        np.zeros(count, dtype) if ids is None else np.asarray(ids, dtype)
        for ids, count in zip(per_mesh, counts, strict=True)
    ]
    return np.concatenate(parts) if parts else np.empty(0, dtype)


def _looked_up(ids: NDArray[Any], triangle_ids: NDArray[np.int64]) -> NDArray[Any]:
    hit = triangle_ids != NO_TRIANGLE
    found = np.zeros(triangle_ids.shape, dtype=ids.dtype)
    found[hit] = ids[triangle_ids[hit]]
    return found
