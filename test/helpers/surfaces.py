"""Surfaces, and cameras over them, whose figures are known."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, pose_looking_down, pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics, TriangleMesh
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh

CAMERA = PinholeIntrinsics(160, 120, 135.285, 135.285, 79.5, 59.5)


def grid_mesh(
    x_m: tuple[float, float], y_m: tuple[float, float], z_m: float | FloatArray, step_m: float = 0.1
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return the vertices and triangles of a height field over a rectangle."""
    columns = round((x_m[1] - x_m[0]) / step_m) + 1
    rows = round((y_m[1] - y_m[0]) / step_m) + 1
    x, y = np.meshgrid(np.linspace(*x_m, columns), np.linspace(*y_m, rows))
    vertices_m = np.column_stack((x.ravel(), y.ravel(), np.broadcast_to(z_m, x.shape).ravel()))
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return vertices_m, np.stack((a, b, c, a, c, d), -1).reshape(-1, 3).astype(np.int32)


def hills(half_m: float, step_m: float = 0.1) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return hills of 0.4 m, 4 m long in x and 5 m in y, with slopes up to 32 degrees."""
    count = round(2 * half_m / step_m) + 1
    x, y = np.meshgrid(*[np.linspace(-half_m, half_m, count)] * 2)
    z_m = 0.4 * (np.sin(2 * np.pi * x / 4) + np.cos(2 * np.pi * y / 5))
    return grid_mesh((-half_m, half_m), (-half_m, half_m), z_m, step_m)


def sphere(radius_m: float, centre_m: FloatArray) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return a fine sphere by Open3D."""
    mesh = o3d.geometry.TriangleMesh.create_sphere(radius_m, 80)
    return np.asarray(mesh.vertices) + centre_m, np.asarray(mesh.triangles, np.int32)


def colored(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> ColoredMesh:
    """Return a grey reconstruction."""
    return ColoredMesh(vertices_m, triangles, np.full((len(vertices_m), 3), 90, np.uint8))


def down(x_m: float, y_m: float, z_m: float, camera: PinholeIntrinsics = CAMERA) -> PosedCamera:
    """Return a camera that looks down from a place."""
    return PosedCamera(camera, pose_to_matrix(pose_looking_down(x_m, y_m, z_m)) @ T_LINK_OPTICAL)


def depth_seen(truth: TriangleMesh, view: PosedCamera) -> NDArray[np.float32]:
    """Return (H, W) planar depth of a true mesh, by Open3D's ray casting."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(truth.vertices_m.astype(np.float32)),
        o3d.core.Tensor(truth.triangles.astype(np.uint32)),
    )
    camera = view.intrinsics
    directions = pixel_rays(camera).reshape(-1, 3) @ view.T_map_camera[:3, :3].T
    origins_m = np.broadcast_to(view.T_map_camera[:3, 3], directions.shape)
    rays = np.column_stack((origins_m, directions)).astype(np.float32)
    found: NDArray[np.float32] = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return found.reshape(camera.height_px, camera.width_px)
