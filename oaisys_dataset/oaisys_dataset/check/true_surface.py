"""The true surface of a world, on which what its sensors measured must lie."""

from __future__ import annotations

import numpy as np

from oaisys_core.types import Extent, FloatArray, TriangleMesh

LARGEST_STRAY_SHARE = 5e-3
"""Of random points of a frame or scan: those on tessellated solids are a little off their
triangles."""

POINT_TOLERANCE = 2e-4
"""Distance of a point from the surface, relative to its distance from the sensor."""

POSE_TOLERANCE = 1e-6
"""Largest difference of a number in the pose of a sensor."""


class WorldSurface:
    """The surface of a world.

    Args:
        mesh: Ground and objects.
        extent_m: (min_x, min_y, max_x, max_y) of the ground. Objects reach over its edge, beyond
            which the land is not part of the mesh.
    """

    def __init__(self, mesh: TriangleMesh, extent_m: Extent) -> None:
        import open3d as o3d

        from oaisys_core.raycast.open3d_bvh import open3d_scene

        self._scene = open3d_scene(mesh.vertices_m, mesh.triangles)
        self._tensor = o3d.core.Tensor
        self._low_m, self._high_m = np.reshape(extent_m, (2, 2))

    def stray(self, points_m: FloatArray, ranges_m: FloatArray) -> tuple[int, int]:
        """Return how many points can be judged, and how many of them are off the surface.

        Args:
            points_m: (N, 3) points in ``map``.
            ranges_m: (N,) distances from the sensor.
        """
        away_m = self._distance_m(points_m)
        judged = ~np.isnan(away_m)
        return int(judged.sum()), int((away_m > POINT_TOLERANCE * ranges_m)[judged].sum())

    @staticmethod
    def is_wrong(judged: int, stray: int) -> bool:
        """Return whether more points are off the surface than tessellation explains."""
        return stray > LARGEST_STRAY_SHARE * judged

    def _distance_m(self, points_m: FloatArray) -> FloatArray:
        """Return (N,) distances of (N, 3) points; NaN beyond the stage, where no triangles are."""
        query = self._tensor(points_m.astype(np.float32))
        away_m = self._scene.compute_distance(query).numpy().astype(np.float64)
        inside = (points_m[:, :2] > self._low_m) & (points_m[:, :2] < self._high_m)
        away_m[~inside.all(axis=1)] = np.nan
        return np.asarray(away_m)
