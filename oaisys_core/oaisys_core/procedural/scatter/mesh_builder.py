"""Building meshes from coloured parts: strips, tubes, boxes and rods."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.color import linear, srgb
from oaisys_core.scene import MeshPrototype
from oaisys_core.scene.objects import FIRST_NEEDLE, NEEDLE_STEP
from oaisys_core.types import FloatArray

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
"""Corners of a cube with edges of length 2."""

CUTICLE = 0.034
"""Share of light that the wax on a leaf reflects without colouring it: Fresnel's law at the
vertical for a refractive index of 1.45 (Bousquet et al., Remote Sens. Environ. 98, 2005). Without
it, leaves have the blue of their pigments alone, and look neon."""


class MeshBuilder:
    """Collects the parts of a mesh; parts share no vertices, so that their edges stay sharp."""

    def __init__(self) -> None:
        self._vertices: list[FloatArray] = []
        self._triangles: list[NDArray[np.int32]] = []
        self._colors: list[FloatArray] = []
        self._translucency: list[FloatArray] = []
        self._needles: list[FloatArray] = []
        self._count = 0

    def add(
        self,
        vertices_m: ArrayLike,
        triangles: ArrayLike,
        color_srgb: ArrayLike,
        *,
        translucency: float = 0.0,
        needles: ArrayLike = 0.0,
    ) -> None:
        """Add (V, 3) vertices and (T, 3) triangles with a (3,) colour or (V, 3) colours, 0 to 1.

        Args:
            vertices_m, triangles, color_srgb: The mesh.
            translucency: Share of scattered light that leaves on the other side, as through leaves.
            needles: (V,) numbers of needles from the end of a row, of what stands for rows.
        """
        vertices = np.asarray(vertices_m, dtype=np.float64)
        self._vertices.append(vertices)
        self._triangles.append(np.asarray(triangles, np.int32) + np.int32(self._count))
        self._colors.append(np.broadcast_to(np.asarray(color_srgb, np.float64), vertices.shape))
        self._translucency.append(np.full(len(vertices), translucency))
        self._needles.append(np.broadcast_to(np.asarray(needles, np.float64), len(vertices)))
        self._count += len(vertices)

    @property
    def triangle_count(self) -> int:
        """Number of triangles so far."""
        return sum(len(each) for each in self._triangles)

    @property
    def extent(self) -> float:
        """Length of the longest axis so far."""
        low = np.min([each.min(axis=0) for each in self._vertices if len(each)], axis=0)
        high = np.max([each.max(axis=0) for each in self._vertices if len(each)], axis=0)
        return float((high - low).max())

    def strip(
        self,
        left_m: FloatArray,
        right_m: FloatArray,
        colors: ArrayLike,
        *,
        pointed: bool = True,
        translucency: float = 0.0,
    ) -> None:
        """Add a strip between two (K, 3) edges, with (3,) or (K, 3) colours from foot to tip.

        Args:
            pointed: Whether it ends in a point midway between the last two.
            translucency: See `add`.
        """
        count = len(left_m)
        colors = np.broadcast_to(np.asarray(colors, np.float64), (count, 3))
        if pointed:
            tip = (left_m[-1:] + right_m[-1:]) / 2
            vertices = np.vstack((left_m[:-1], right_m[:-1], tip))
            colors = np.vstack((colors[:-1], colors[:-1], colors[-1:]))
            count -= 1
        else:
            vertices, colors = np.vstack((left_m, right_m)), np.vstack((colors, colors))
        a = np.arange(count - 1)
        b, c, d = a + count, a + count + 1, a + 1
        triangles = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
        if pointed:
            last = [[count - 1, 2 * count - 1, 2 * count]]
            triangles = np.vstack((triangles, last))
        self.add(vertices, triangles, colors, translucency=translucency)

    def tube(
        self, points_m: ArrayLike, radii_m: ArrayLike, colors: ArrayLike, sides: int = 3
    ) -> None:
        """Add a tube through (K, 3) points with (K,) radii, open at both ends."""
        points = np.asarray(points_m, dtype=np.float64)
        count = len(points)
        radii = np.broadcast_to(np.asarray(radii_m, np.float64), count)
        along = np.gradient(points, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        across = _across(along)
        other = np.cross(along, across)
        angle = np.arange(sides) * (2 * np.pi / sides)
        ring = np.cos(angle)[:, None] * across[:, None] + np.sin(angle)[:, None] * other[:, None]
        vertices = (points[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
        row, side = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
        a = (row * sides + side).ravel()
        b = (row * sides + (side + 1) % sides).ravel()
        triangles = np.vstack(
            (
                np.column_stack((a, b, b + sides)),
                np.column_stack((a, b + sides, a + sides)),
            )
        )
        colors = np.broadcast_to(np.asarray(colors, np.float64), (count, 3))
        self.add(vertices, triangles, np.repeat(colors, sides, axis=0))

    def box(
        self,
        centre_m: ArrayLike,
        size_m: ArrayLike,
        color_srgb: ArrayLike,
        R: ArrayLike | None = None,
        bevel_m: float = 0.0,
    ) -> None:
        """Add a box with (3,) edge lengths, rotated by a (3, 3) matrix about its centre.

        Its edges are cut by ``bevel_m`` along both faces.
        """
        if bevel_m:
            self._bevel_box(centre_m, size_m, color_srgb, R, bevel_m)
            return
        corners = CORNERS / 2
        faces = "0132 4675 0451 2376 0264 1573"
        vertices = np.array([corners[int(i)] for face in faces.split() for i in face])
        vertices = vertices * np.asarray(size_m, dtype=np.float64)
        if R is not None:
            vertices = vertices @ np.asarray(R, dtype=np.float64).T
        corner = np.arange(24).reshape(6, 4)
        triangles = np.vstack((corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]))
        self.add(vertices + np.asarray(centre_m), triangles, color_srgb)

    def _bevel_box(
        self,
        centre_m: ArrayLike,
        size_m: ArrayLike,
        color_srgb: ArrayLike,
        R: ArrayLike | None,
        bevel_m: float,
    ) -> None:
        half_m = np.asarray(size_m, np.float64) / 2
        inner_m = half_m - min(bevel_m, 0.9 * half_m.min())
        # A vertex of each corner on each of its three faces.
        on_face = CORNERS[:, None] * np.where(np.eye(3, dtype=bool), half_m, inner_m)
        corner, axis, triangles = _bevel_template()
        turn = np.eye(3) if R is None else np.asarray(R, np.float64)
        self.add(on_face[corner, axis] @ turn.T + np.asarray(centre_m), triangles, color_srgb)

    def rod(
        self,
        start_m: ArrayLike,
        end_m: ArrayLike,
        radius_m: float | tuple[float, float],
        color_srgb: ArrayLike,
        sides: int = 12,
    ) -> None:
        """Add a closed cylinder or truncated cone between two points, with sharp ends."""
        start, end = np.asarray(start_m, np.float64), np.asarray(end_m, np.float64)
        radii = (radius_m, radius_m) if isinstance(radius_m, int | float) else radius_m
        along = (end - start) / np.linalg.norm(end - start)
        across = _across(along[None])[0]
        other = np.cross(along, across)
        angle = np.arange(sides) * (2 * np.pi / sides)
        ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
        low, high = start + radii[0] * ring, end + radii[1] * ring
        a = np.arange(sides)
        b = (a + 1) % sides
        side = np.vstack(
            (np.column_stack((a, b, b + sides)), np.column_stack((a, b + sides, a + sides)))
        )
        self.add(np.vstack((low, high)), side, color_srgb)
        fan = np.column_stack((np.zeros(sides - 2, int), a[1:-1], a[2:]))
        self.add(low, fan[:, ::-1], color_srgb)
        self.add(high, fan, color_srgb)

    def mesh(self, name: str, dust_m: float = 0.0) -> MeshPrototype:
        """Return the mesh of all parts, leaves with their wax; ``dust_m``: see `MeshPrototype`."""
        colors = np.clip(np.vstack(self._colors), 0, 1)
        translucency = np.concatenate(self._translucency)
        leaves = translucency > 0
        colors[leaves] = _under_cuticle(colors[leaves])
        needles = np.concatenate(self._needles)
        across = np.rint(FIRST_NEEDLE + NEEDLE_STEP * needles).astype(np.uint8)
        mean = colors.mean(axis=0)
        return MeshPrototype(
            name=name,
            vertices_m=np.vstack(self._vertices).astype(np.float32),
            triangles=np.vstack(self._triangles).astype(np.int32),
            color_srgb=(float(mean[0]), float(mean[1]), float(mean[2])),
            vertex_colors_srgb=np.rint(colors * 255).astype(np.uint8),
            translucency=np.rint(translucency * 255).astype(np.uint8)
            if translucency.any()
            else None,
            needles=across if needles.any() else None,
            dust_m=dust_m,
        )

    def mesh_of_size_1(self, name: str) -> MeshPrototype:
        """Return the mesh of all parts, scaled to 1 m along its longest axis."""
        mesh = self.mesh(name)
        vertices = mesh.vertices_m.astype(np.float64)
        vertices /= np.ptp(vertices, axis=0).max()
        return replace(mesh, vertices_m=vertices.astype(np.float32))


@cache
def _bevel_template() -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.int32]]:
    """Return the (V,) corners of a bevelled box's vertices, the axes of their faces, and triangles.

    Its faces, edges and corners share no vertices.
    """
    on_face = CORNERS[:, None] * np.where(np.eye(3, dtype=bool), 1.0, 0.5)
    places: list[tuple[int, int]] = []
    triangles: list[tuple[int, int, int]] = []
    for polygon in _bevel_polygons():
        a, b, c = (on_face[place] for place in polygon[:3])
        ordered = polygon if np.cross(b - a, c - a) @ a > 0 else polygon[::-1]
        first = len(places)
        triangles += [(first, first + i, first + i + 1) for i in range(1, len(ordered) - 1)]
        places += ordered
    corner, axis = np.array(places).T
    return corner, axis, np.array(triangles, np.int32)


def _bevel_polygons() -> list[list[tuple[int, int]]]:
    """Return the corners, faces and edges of a bevelled box, as (corner, face's axis) each."""
    polygons = [[(corner, axis) for axis in range(3)] for corner in range(len(CORNERS))]
    for axis in range(3):
        first, second = (each for each in range(3) if each != axis)
        for sign in (-1, 1):
            ring = [(-1, -1), (-1, 1), (1, 1), (1, -1)]
            polygons.append(
                [(_corner({axis: sign, first: one, second: two}), axis) for one, two in ring]
            )
        for one, two in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            low, high = (_corner({first: one, second: two, axis: end}) for end in (-1, 1))
            polygons.append([(low, first), (high, first), (high, second), (low, second)])
    return polygons


def _corner(signs: dict[int, int]) -> int:
    """Return the index of a corner by its sign along each axis."""
    return int(np.flatnonzero(np.equal(CORNERS, [signs[axis] for axis in range(3)]).all(axis=1))[0])


def _under_cuticle(color_srgb: FloatArray) -> FloatArray:
    """Return (N, 3) colours of leaves with the light that their wax reflects."""
    return np.asarray(srgb(CUTICLE + (1 - CUTICLE) * linear(color_srgb)))


def _across(along: FloatArray) -> FloatArray:
    """Return (N, 3) unit vectors perpendicular to (N, 3) unit vectors."""
    steep = np.abs(along[:, 2:]) > 0.9
    helper = np.where(steep, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    across = np.cross(helper, along)
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))
