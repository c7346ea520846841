"""Bounding volume hierarchies (BVH) of triangles: their interface, and Open3D's.

Open3D is imported on first use; see `oaisys_core.private.open3d_import` for ``bpy`` in the same
process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray


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
