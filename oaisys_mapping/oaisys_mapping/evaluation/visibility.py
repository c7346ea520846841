"""Visibility of a surface from cameras.

Visibility is computed for points spread evenly over the surface, not for pixels, which are denser
where a surface is near and faces the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import invert, project, transform_points, unproject
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr, TriangleMesh
from oaisys_mapping.mesh import SurfacePoints
from oaisys_mapping.progress import ProgressCallback, ignore_progress

OCCLUSION_TOLERANCE = 1e-4
"""Share of the distance by which a point may lie behind the first hit and still be visible."""


@dataclass(frozen=True, repr=False)
class PosedCamera(ShortRepr):
    """A camera without distortion, and its pose.

    Attributes:
        T_map_camera: (4, 4) pose of the optical frame.
    """

    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray

    def __post_init__(self) -> None:
        """Refuse distortion; see `rectify_camera`."""
        if not self.intrinsics.is_rectilinear:
            received = (self.intrinsics.distortion_model, self.intrinsics.distortion)
            raise InvalidInputError("intrinsics.distortion", received, "a pinhole without any")


def within_reach(
    truth: TriangleMesh, views: Sequence[PosedCamera], max_range_m: float
) -> NDArray[np.bool_]:
    """Return (T,) which triangles may touch the bounding box of everything that the views can see.

    It saves samples on a truth that is much larger than what was surveyed; no visible triangle is
    left out.
    """
    heights_m = truth.vertices_m[:, 2]
    slab_m = (float(heights_m.min()), float(heights_m.max()))
    corners_m = [_frustum_in_slab(view, max_range_m, slab_m) for view in views]
    found_m = np.concatenate([np.empty((0, 3)), *corners_m])
    if not len(found_m):
        return np.zeros(len(truth.triangles), bool)
    outside = np.zeros(len(truth.vertices_m), np.uint8)
    for axis in range(3):
        outside |= (truth.vertices_m[:, axis] < found_m[:, axis].min()).astype(np.uint8) << axis
        outside |= (truth.vertices_m[:, axis] > found_m[:, axis].max()).astype(np.uint8) << axis + 3
    a, b, c = (outside[truth.triangles[:, corner]] for corner in range(3))
    return np.asarray((a & b & c) == 0)


def _frustum_in_slab(
    view: PosedCamera, max_range_m: float, slab_m: tuple[float, float]
) -> FloatArray:
    """Return the (N, 3) corners of a view's frustum, clipped to a range of heights."""
    camera = view.intrinsics
    pixels = [(u, v) for v in (0, camera.height_px - 1) for u in (0, camera.width_px - 1)]
    far_m = unproject(pixels, [max_range_m] * 4, camera)
    corners_m = np.vstack((np.zeros(3), far_m)) @ view.T_map_camera[:3, :3].T
    corners_m += view.T_map_camera[:3, 3]
    low_m, high_m = slab_m[0] - 1e-6, slab_m[1] + 1e-6
    kept = [corners_m[(corners_m[:, 2] >= low_m) & (corners_m[:, 2] <= high_m)]]
    edges = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 4), (4, 3), (3, 1))
    for start_m, end_m in (corners_m[list(edge)] for edge in edges):
        for height_m in (low_m, high_m):
            if (start_m[2] - height_m) * (end_m[2] - height_m) < 0:
                share = (height_m - start_m[2]) / (end_m[2] - start_m[2])
                kept.append((start_m + share * (end_m - start_m))[None])
    return np.concatenate(kept)


def raycasting_scene(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> Any:
    """Return Open3D's Embree scene of a mesh."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices_m, np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
    )
    return scene


def visible_from_any(
    points: SurfacePoints, views: Sequence[PosedCamera], scene: Any, max_range_m: float
) -> NDArray[np.bool_]:
    """Return (N,) whether at least one view sees each point of a surface.

    For the arguments see `views_seeing`.
    """
    return views_seeing(points, views, scene, max_range_m, 1) > 0


def views_seeing(
    points: SurfacePoints,
    views: Sequence[PosedCamera],
    scene: Any,
    max_range_m: float,
    max_count: int,
    on_progress: ProgressCallback = ignore_progress,
) -> NDArray[np.uint8]:
    """Return (N,) how many views see each point of a surface, counted up to ``max_count``.

    A view sees a point that projects into its image, faces the camera, lies within ``max_range_m``
    along z, and is not occluded.

    Args:
        points: Points on the surface.
        views: The cameras.
        scene: `raycasting_scene` of the whole surface.
        max_range_m: Depth beyond which nothing is visible.
        max_count: From 1 to 255.
        on_progress: Called for each view.
    """
    times = np.zeros(len(points.points_m), np.uint8)
    for number, view in enumerate(views, start=1):
        on_progress(f"what view {number} of {len(views)} sees of the truth")
        candidates = np.flatnonzero(times < max_count)
        candidates = candidates[_in_image(points, candidates, view, max_range_m)]
        times[candidates[_is_visible(points.points_m[candidates], view, scene)]] += 1
    return times


def _in_image(
    points: SurfacePoints, ids: NDArray[np.intp], view: PosedCamera, max_range_m: float
) -> NDArray[np.bool_]:
    camera_m = transform_points(invert(view.T_map_camera), points.points_m[ids])
    ahead = (camera_m[:, 2] > 1e-6) & (camera_m[:, 2] <= max_range_m)
    pixels = np.full((len(ids), 2), -1.0)
    pixels[ahead] = project(camera_m[ahead], view.intrinsics)
    last = (view.intrinsics.width_px - 1, view.intrinsics.height_px - 1)
    inside = ((pixels >= 0) & (pixels <= last)).all(axis=1)
    to_camera = view.T_map_camera[:3, 3] - points.points_m[ids]
    facing = (points.normals[ids] * to_camera).sum(axis=1) > 0
    return np.asarray(ahead & inside & facing)


def _is_visible(points_m: FloatArray, view: PosedCamera, scene: Any) -> NDArray[np.bool_]:
    import open3d as o3d

    origin_m = view.T_map_camera[:3, 3]
    rays = np.empty((len(points_m), 6), np.float32)
    rays[:, :3] = origin_m
    rays[:, 3:] = points_m - origin_m
    # A ray is as long as the distance to its point, so a visible point is hit at 1.
    first = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return np.asarray(first >= 1 - OCCLUSION_TOLERANCE)
