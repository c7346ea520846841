"""Triangle meshes with colour, and operations that metrics need of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class ColoredMesh:
    """Triangles in ``map`` with a colour per vertex.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 vertex indices.
        colors_rgb: (V, 3) uint8.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    colors_rgb: NDArray[np.uint8]


@dataclass(frozen=True)
class SurfacePoints:
    """Points spread evenly over a mesh.

    Attributes:
        points_m: (N, 3) float64.
        normals: (N, 3) float64 unit normals of their triangles.
        triangle_ids: (N,) int64.
    """

    points_m: FloatArray
    normals: FloatArray
    triangle_ids: NDArray[np.int64]


def triangle_areas_m2(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Return the (T,) areas of triangles."""
    return np.asarray(np.linalg.norm(_cross(vertices_m, triangles), axis=1) / 2)


def sample_surface(
    vertices_m: FloatArray, triangles: NDArray[np.int32], count: int, rng: np.random.Generator
) -> SurfacePoints:
    """Return ``count`` points spread evenly by area: one at a random place of each equal share.

    Systematic sampling along the cumulated area; within its triangle a point is uniform (Osada et
    al., "Shape distributions", ACM TOG 21(4), 2002, eq. 1).
    """
    areas_m2 = triangle_areas_m2(vertices_m, triangles)
    cumulated = np.cumsum(areas_m2)
    place = (np.arange(count) + rng.uniform()) * (cumulated[-1] / count)
    ids = np.minimum(np.searchsorted(cumulated, place, side="right"), len(triangles) - 1)
    a, b, c = (vertices_m[triangles[ids, corner]] for corner in range(3))
    root, along = np.sqrt(rng.uniform(size=count))[:, None], rng.uniform(size=count)[:, None]
    points_m = (1 - root) * a + root * (1 - along) * b + root * along * c
    normals = _cross(vertices_m, triangles[ids])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return SurfacePoints(points_m, normals, ids)


def in_canonical_order(mesh: ColoredMesh) -> ColoredMesh:
    """Return the mesh with sorted vertices and triangles: equal meshes have equal bytes."""
    order = np.lexsort(mesh.vertices_m.T[::-1])
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    triangles = rank[mesh.triangles]
    first = triangles.argmin(axis=1)
    turned = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    turned = turned[np.lexsort(turned.T[::-1])].astype(np.int32)
    return ColoredMesh(mesh.vertices_m[order], turned, mesh.colors_rgb[order])


def _cross(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    a, b, c = (vertices_m[triangles[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a))
