"""Planes and spheres seen by a camera, in closed form, and volumes that integrated them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, pose_looking_at, pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.tsdf import TsdfVolume

CAMERA = PinholeIntrinsics(320, 240, 270.57, 270.57, 159.5, 119.5)
UP = np.array([0.0, 0.0, 1.0])


def camera_at(eye_m: tuple[float, float, float], at_m: tuple[float, float, float]) -> FloatArray:
    """Return the (4, 4) pose of an optical frame at ``eye_m`` that looks at ``at_m``."""
    return pose_to_matrix(pose_looking_at(eye_m, at_m)) @ T_LINK_OPTICAL


def plane_depth_m(T: FloatArray, normal: FloatArray, offset_m: float) -> NDArray[np.float32]:
    """Return (240, 320) depth of the plane ``normal . p = offset_m`` seen from ``T``."""
    rays = pixel_rays(CAMERA) @ T[:3, :3].T
    with np.errstate(divide="ignore"):
        depth_m = (offset_m - normal @ T[:3, 3]) / (rays @ normal)
    depth_m[depth_m <= 0] = np.inf
    return depth_m.astype(np.float32)


def sphere_depth_m(T: FloatArray, radius_m: float) -> NDArray[np.float32]:
    """Return (240, 320) depth of a sphere around the origin seen from ``T``."""
    rays = pixel_rays(CAMERA) @ T[:3, :3].T
    a, b = (rays**2).sum(-1), rays @ T[:3, 3]
    discriminant = b**2 - a * (T[:3, 3] @ T[:3, 3] - radius_m**2)
    with np.errstate(invalid="ignore"):
        depth_m = (-b - np.sqrt(discriminant)) / a
    return np.asarray(np.nan_to_num(depth_m, nan=np.inf), np.float32)


def flight(count: int, spacing_m: float = 4.0) -> list[FloatArray]:
    """Return camera poses 6 m above the ground along x, looking down."""
    return [camera_at((spacing_m * i + 0.01, 0, 6), (spacing_m * i, 0, 0)) for i in range(count)]


def fly(volume: TsdfVolume, poses: list[FloatArray]) -> TsdfVolume:
    """Integrate views of a tilted plane, with colours and classes, from the poses."""
    normal = np.array([0.1, 0.05, 1.0])
    normal /= np.linalg.norm(normal)
    for index, T in enumerate(poses):
        rgb = np.full((240, 320, 3), (40 * index % 256, 100, 50), np.uint8)
        labels = np.full((240, 320), 1 + index % 3, np.uint16)
        depth_m = plane_depth_m(T, normal, 0.033)
        volume.integrate(depth_m, rgb, CAMERA, T, labels)
    return volume


def same_mesh(one: ColoredMesh, other: ColoredMesh) -> bool:
    """Return whether two meshes are equal in every array."""
    names = ("vertices_m", "triangles", "colors_rgb", "class_ids", "class_probabilities")
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(a is b is None or np.array_equal(a, b) for a, b in pairs)
