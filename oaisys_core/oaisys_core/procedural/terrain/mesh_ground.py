"""Ground made from a user's mesh."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.checks import MAX_COORDINATE, local_origin
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.types import FloatArray, TriangleMesh

LOG = logging.getLogger(__name__)

AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}
"""By the axis that points up, the axes of the file that become x, y and z (a rotation)."""


@dataclass(frozen=True)
class MeshGround:
    """A ground of arbitrary triangles; where it overhangs, its height is that of the top.

    Attributes:
        points_m: (V, 3) float32 in ``map``.
        corners: (T, 3) int32.
        local_origin_m: Where the origin of ``map`` is in the coordinates that the configuration
            gives to the file; 0, or whole metres if the file lies far from it.
    """

    points_m: NDArray[np.float32]
    corners: NDArray[np.int32]
    local_origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(min_x, min_y, max_x, max_y) of the ground."""
        x0, y0 = self.points_m[:, :2].min(axis=0)
        x1, y1 = self.points_m[:, :2].max(axis=0)
        return (float(x0), float(y0), float(x1), float(y1))

    @cached_property
    def spacing_m(self) -> float:
        """Edge of a square with twice the mean triangle area, seen from above."""
        a, b, c = (self.points_m[self.corners[:, i], :2].astype(np.float64) for i in range(3))
        u, v = b - a, c - a
        doubled = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        return float(np.sqrt(doubled.mean()))

    def vertices_m(self) -> NDArray[np.float32]:
        """Return (V, 3) float32 vertices in ``map``."""
        return self.points_m

    def triangles(self) -> NDArray[np.int32]:
        """Return (T, 3) int32 indices."""
        return self.corners

    def height_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N,) heights of the topmost triangle at (N, 2) points; NaN outside it."""
        return self._target.surface_height_m(xy_m)

    @cached_property
    def _target(self) -> TriangleTarget:
        return TriangleTarget([TriangleMesh(self.points_m.astype(np.float64), self.corners)])


def mesh_ground(
    mesh: LoadedMesh, scale: float, up: str, position_m: tuple[float, float, float]
) -> MeshGround:
    """Return a loaded mesh as ground.

    Args:
        mesh: The mesh as it is in its file.
        scale: Metres per unit.
        up: Axis that points up: ``x``, ``y`` or ``z``.
        position_m: Position of the mesh's origin.

    Raises:
        InvalidInputError: It would be too large.
    """
    turned = mesh.vertices_m[:, AXES[up]].astype(np.float64)
    exact_m = turned * scale + np.asarray(position_m)
    farthest_m = float(np.abs(exact_m).max())
    if not farthest_m <= MAX_COORDINATE:
        expected = f"a ground within {MAX_COORDINATE:.0f} m, not {farthest_m:.12g} m"
        raise InvalidInputError("stage.mesh.scale", scale, expected)
    origin_m = local_origin(exact_m)
    if origin_m.any():
        LOG.warning(
            "%s: lies far from the origin, so the map's origin is at [%s] of its coordinates",
            mesh.name,
            ", ".join(f"{value:.0f}" for value in origin_m),
        )
    points_m = (exact_m - origin_m).astype(np.float32)
    x, y, z = origin_m.tolist()
    return MeshGround(points_m, _facing_up(points_m, mesh.triangles), (x, y, z))


def _facing_up(points_m: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the triangles, all flipped if most of their area faces down."""
    a, b, c = (points_m[triangles[:, i]].astype(np.float64) for i in range(3))
    upward = np.cross(b - a, c - a)[:, 2].sum()
    return triangles if upward >= 0 else np.ascontiguousarray(triangles[:, ::-1])
