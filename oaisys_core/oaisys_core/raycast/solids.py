"""Spheres, boxes and level rectangles, which rays hit in closed form (float64)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.geometry import invert, transform_points
from oaisys_core.raycast.targets.ray_target import NO_ELEMENT, RayTarget
from oaisys_core.scene import Ground, HeightField, Primitive
from oaisys_core.types import FloatArray, TriangleMesh

TESSELLATION_ERROR_M = 5e-4
"""Largest distance between a sphere and its tessellation."""


class Solid(Protocol):
    """A shape that rays can hit."""

    def intersect(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """Return (...) distances in units of the directions' lengths, ``+inf`` for a miss.

        Args:
            origins_m: (..., 3) in ``map``, or (3,) for all rays.
            directions: (..., 3) of any length.
        """

    def normals_at(self, points_m: FloatArray) -> FloatArray:
        """Return the (N, 3) outward unit normals at (N, 3) points of the surface."""


@dataclass(frozen=True)
class Sphere:
    """A sphere around ``centre_m``."""

    centre_m: FloatArray
    radius_m: float

    def intersect(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """See `Solid`; the smallest positive root of ``|o + t d - c|² = r²``."""
        offset = origins_m - self.centre_m
        a = (directions * directions).sum(axis=-1)
        b = (offset * directions).sum(axis=-1)
        c = (offset * offset).sum(axis=-1) - self.radius_m**2
        with np.errstate(invalid="ignore"):
            root = np.sqrt(b * b - a * c)
        near, far = (-b - root) / a, (-b + root) / a
        return np.where(near > 0, near, np.where(far > 0, far, np.inf))

    def normals_at(self, points_m: FloatArray) -> FloatArray:
        """See `Solid`."""
        return (points_m - self.centre_m) / self.radius_m


@dataclass(frozen=True)
class Box:
    """A box of edge lengths ``size_m`` around the origin of its own frame."""

    T_map_box: FloatArray
    size_m: tuple[float, float, float]

    def intersect(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """See `Solid`; by the slab method, between the three pairs of faces."""
        T_box_map = invert(self.T_map_box)
        o = transform_points(T_box_map, origins_m)
        d = directions @ T_box_map[:3, :3].T
        half = np.asarray(self.size_m) / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-half - o) / d, (half - o) / d
        enter = np.fmin(first, second).max(axis=-1)
        leave = np.fmax(first, second).min(axis=-1)
        nearest = np.where(enter > 0, enter, leave)
        return np.where((enter <= leave) & (leave > 0), nearest, np.inf)

    def normals_at(self, points_m: FloatArray) -> FloatArray:
        """See `Solid`; the normal of the face that the point is nearest to."""
        R, centre_m = self.T_map_box[:3, :3], self.T_map_box[:3, 3]
        relative = (points_m - centre_m) @ R / (np.asarray(self.size_m) / 2)
        axis = np.argmax(np.abs(relative), axis=1)
        rows = np.arange(len(points_m))
        return np.asarray(R.T[axis] * np.sign(relative[rows, axis])[:, None])


@dataclass(frozen=True)
class Rectangle:
    """A level rectangle, facing up: an exactly flat ground."""

    extent_m: tuple[float, float, float, float]
    height_m: float

    def intersect(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """See `Solid`."""
        x0, y0, x1, y1 = self.extent_m
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.height_m - origins_m[..., 2]) / directions[..., 2]
            x = origins_m[..., 0] + t * directions[..., 0]
            y = origins_m[..., 1] + t * directions[..., 1]
        met = (t > 0) & (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        return np.where(met, t, np.inf)

    def normals_at(self, points_m: FloatArray) -> FloatArray:
        """See `Solid`."""
        return np.broadcast_to((0.0, 0.0, 1.0), points_m.shape)


class SolidTarget(RayTarget):
    """One exact solid, with a single element."""

    def __init__(self, solid: Solid, instance_id: int, top_m: float) -> None:
        """Take a solid whose highest point is at most at ``top_m``."""
        self._solid = solid
        self._instance_id = instance_id
        self.top_m = top_m

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`."""
        distances = self._solid.intersect(origins_m, directions)
        return distances, np.where(np.isfinite(distances), 0, NO_ELEMENT)

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """See `RayTarget`."""
        return np.where(elements == NO_ELEMENT, 0, self._instance_id).astype(np.uint32)

    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        return self._solid.normals_at(points_m)


def target_of(primitive: Primitive) -> SolidTarget:
    """Return a primitive as a ray target."""
    top_m = float(primitive.T_map_object[2, 3] + np.linalg.norm(primitive.size_m))
    return SolidTarget(_solid_of(primitive), primitive.instance_id, top_m)


def _solid_of(primitive: Primitive) -> Solid:
    if primitive.shape == "sphere":
        return Sphere(primitive.T_map_object[:3, 3], primitive.size_m[0])
    if primitive.shape == "box":
        return Box(primitive.T_map_object, primitive.size_m)
    raise RenderError(f"primitive {primitive.instance_id} has the unknown shape {primitive.shape}")


def flat_ground(ground: Ground) -> Rectangle | None:
    """Return the rectangle of an exactly flat ground, None for any other."""
    if not isinstance(ground, HeightField):
        return None
    height_m = ground.elevation_m.flat[0]
    if (ground.elevation_m == height_m).all():
        return Rectangle(ground.extent_m, float(height_m))
    return None


def tessellate(primitive: Primitive) -> TriangleMesh:
    """Return the triangles of a primitive in its own frame, counter-clockwise from outside.

    A sphere's vertices lie on it; its triangles deviate by at most `TESSELLATION_ERROR_M`.
    """
    if primitive.shape == "sphere":
        return _sphere_mesh(primitive.size_m[0])
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = np.array(
        [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    )
    triangles = np.concatenate((quads[:, (0, 1, 2)], quads[:, (0, 2, 3)])).astype(np.int32)
    return TriangleMesh(corners * primitive.size_m, triangles)


def _sphere_mesh(radius_m: float) -> TriangleMesh:
    """Return a sphere tessellated along meridians and parallels.

    A patch that spans an angle a in both directions deviates by r (1 - cos(a / √2)) ≈ r a² / 4.
    """
    rings = max(8, ceil(pi / sqrt(4 * TESSELLATION_ERROR_M / radius_m)))
    sectors = 2 * rings
    polar = np.linspace(0, pi, rings + 1)[1:-1]
    azimuth = np.linspace(0, 2 * pi, sectors, endpoint=False)
    grid = np.empty((rings - 1, sectors, 3))
    grid[..., 0] = np.sin(polar)[:, None] * np.cos(azimuth)
    grid[..., 1] = np.sin(polar)[:, None] * np.sin(azimuth)
    grid[..., 2] = np.cos(polar)[:, None]
    vertices = np.concatenate((grid.reshape(-1, 3), [(0, 0, 1), (0, 0, -1)]))
    index = np.arange((rings - 1) * sectors).reshape(rings - 1, sectors)
    after = np.roll(index, -1, axis=1)
    north, south = np.full(sectors, len(vertices) - 2), np.full(sectors, len(vertices) - 1)
    triangles = [
        np.stack((north, index[0], after[0]), axis=-1),
        np.stack((south, after[-1], index[-1]), axis=-1),
        np.stack((index[:-1], index[1:], after[1:]), axis=-1).reshape(-1, 3),
        np.stack((index[:-1], after[1:], after[:-1]), axis=-1).reshape(-1, 3),
    ]
    return TriangleMesh(vertices * radius_m, np.concatenate(triangles).astype(np.int32))
