"""Triangle meshes with colour, and points sampled on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr

MIN_POINTS = 20_000
"""Least number of points on a surface, so that shares are accurate to a percent."""


@dataclass(frozen=True, repr=False)
class ColoredMesh(ShortRepr):
    """A triangle mesh in ``map`` with a colour per vertex.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 vertex indices.
        colors_rgb: (V, 3) uint8.
        class_ids: (V,) uint16 semantic ids, 0 for none; None for a map without classes.
        class_probabilities: (V,) float32 probabilities of those classes, or None.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    colors_rgb: NDArray[np.uint8]
    class_ids: NDArray[np.uint16] | None = None
    class_probabilities: NDArray[np.float32] | None = None


@dataclass(frozen=True, repr=False)
class SurfacePoints(ShortRepr):
    """Points sampled evenly on a mesh.

    Attributes:
        points_m: (N, 3) float64.
        normals: (N, 3) float64 unit normals of their triangles.
        area_m2: Surface area that each point represents.
        triangle_ids: (N,) the triangle that each point lies on.
    """

    points_m: FloatArray
    normals: FloatArray
    area_m2: float
    triangle_ids: NDArray[np.intp]

    def only(self, chosen: NDArray[np.bool_]) -> SurfacePoints:
        """Return the points for which ``chosen`` (N,) is true."""
        return SurfacePoints(
            self.points_m[chosen], self.normals[chosen], self.area_m2, self.triangle_ids[chosen]
        )


def triangle_areas_m2(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Return the (T,) areas of triangles."""
    return np.asarray(np.linalg.norm(_cross(vertices_m, triangles), axis=1) / 2)


def sample_surface(
    vertices_m: FloatArray,
    triangles: NDArray[np.int32],
    spacing_m: float,
    max_points: int,
    rng: np.random.Generator,
) -> SurfacePoints:
    """Return points distributed evenly by area.

    The cumulative area is sampled with stratification; within its triangle a point is uniform
    (Osada et al., "Shape distributions", ACM TOG 21(4), 2002, eq. 1).

    Args:
        vertices_m: (V, 3) vertices.
        triangles: (T, 3) vertex indices.
        spacing_m: A point represents an area of this squared.
        max_points: Limit of the number of points; beyond it each represents a larger area.
        rng: Draws the points.

    Raises:
        InvalidInputError: The triangles have no area.
    """
    cumulative = np.cumsum(triangle_areas_m2(vertices_m, triangles))
    if not (len(cumulative) and 0 < cumulative[-1] < np.inf):
        raise InvalidInputError("mesh", f"{len(cumulative)} triangles", "a surface with an area")
    count = int(np.clip(cumulative[-1] / spacing_m**2, MIN_POINTS, max_points))
    place = (np.arange(count) + rng.uniform(size=count)) * (cumulative[-1] / count)
    ids = np.minimum(np.searchsorted(cumulative, place, side="right"), len(triangles) - 1)
    a, b, c = (vertices_m[triangles[ids, corner]] for corner in range(3))
    root, along = np.sqrt(rng.uniform(size=count))[:, None], rng.uniform(size=count)[:, None]
    points_m = (1 - root) * a + root * (1 - along) * b + root * along * c
    normals = _cross(vertices_m, triangles[ids])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return SurfacePoints(points_m, normals, float(cumulative[-1]) / count, ids)


def _cross(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    a, b, c = (vertices_m[triangles[:, corner]] for corner in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    return np.column_stack((uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx))
