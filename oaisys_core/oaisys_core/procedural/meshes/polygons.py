"""Triangles of polygons: fans where these are right, clipped ears where a polygon is concave."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

MAX_TESTS = 30_000_000
"""Corners that are compared with ears in all polygons of a file: some ten seconds."""

NEGLIGIBLE = 1e-9
"""Share of a polygon's area by which a triangle may be turned over: what rounding does."""

FLAT = 1e-6
"""A polygon with less than this times its length squared is a line, and fanned as it is."""

Point = tuple[float, float]


class PolygonError(ValueError):
    """A polygon has no triangulation.

    Attributes:
        index: Which one, from 0.
    """

    def __init__(self, index: int, expected: str) -> None:
        super().__init__(expected)
        self.index = index


def triangulate(
    vertices: FloatArray, corners: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triangles of polygons in space, in their order.

    Args:
        vertices: (V, 3).
        corners: (C,) indices of vertices, polygon after polygon.
        counts: (P,) corners of each polygon, three or more.

    Returns:
        (T, 3) places in ``corners``, and the (T,) polygon of each triangle.

    Raises:
        PolygonError: A polygon crosses itself, or the concave ones are too intricate.
    """
    starts = np.cumsum(counts) - counts
    first = np.cumsum(counts - 2) - (counts - 2)
    triangles = np.empty((int((counts - 2).sum()), 3), np.int64)
    concave: list[int] = []
    for count in np.unique(counts):
        polygons = np.flatnonzero(counts == count)
        steps = np.arange(count - 2)
        fan = np.stack((np.zeros_like(steps), steps + 1, steps + 2), axis=1)
        rows = first[polygons][:, None] + steps
        triangles[rows] = starts[polygons][:, None, None] + fan
        if count > 3:
            at = starts[polygons][:, None] + np.arange(count)
            is_wrong = ~_is_fan(vertices[corners[at]])
            concave += polygons[is_wrong].tolist()
    tests = 0
    for index in sorted(concave):
        start, count = int(starts[index]), int(counts[index])
        points = _flatten(vertices[corners[start : start + count]])
        ears, used = _clip_ears(points, MAX_TESTS - tests, index)
        tests += used
        triangles[first[index] : first[index] + count - 2] = start + np.array(ears)
    return triangles, np.repeat(np.arange(len(counts)), counts - 2)


def _is_fan(points: FloatArray) -> NDArray[np.bool_]:
    """Return which of (P, N, 3) polygons the triangles around their first corners cover."""
    with np.errstate(all="ignore"):
        arms = points[:, 1:] - points[:, :1]
        areas = np.cross(arms[:, :-1], arms[:, 1:])
        normal = areas.sum(axis=1)
        size = np.linalg.norm(normal, axis=1)
        total = np.linalg.norm(areas, axis=2).sum(axis=1)
        along = np.einsum("pti,pi->pt", areas, normal).min(axis=1)
        turned = (along < -NEGLIGIBLE * total * size) | (size < NEGLIGIBLE * total)
        length = np.abs(arms).max(axis=(1, 2))
        # What is not finite is refused later, by its line.
        return np.asarray(~(turned & (total > FLAT * length**2)))


def _flatten(points: FloatArray) -> list[Point]:
    """Return a polygon (N, 3) on the plane on which it is largest, counterclockwise."""
    arms = points - points[0]
    normal = np.cross(arms[1:-1], arms[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    kept = [(1, 2), (2, 0), (0, 1)][axis]
    flat = arms[:, kept if normal[axis] >= 0 else kept[::-1]]
    return [(x, y) for x, y in flat.tolist()]


def _clip_ears(
    points: Sequence[Point], most: int, index: int
) -> tuple[list[tuple[int, int, int]], int]:
    """Return the triangles of a polygon, and how many corners were compared."""
    crossing = PolygonError(index, "a polygon that does not cross itself")
    if abs(_turning(points) - 2 * math.pi) > 0.1:
        raise crossing
    left = list(range(len(points)))
    found: list[tuple[int, int, int]] = []
    at, missed, tests = 0, 0, 0
    while len(left) > 3:
        ear = (left[at - 1], left[at], left[(at + 1) % len(left)])
        tests += len(left)
        if tests > most:
            expected = "concave polygons that are simpler (Blender triangulates them on export)"
            raise PolygonError(index, expected)
        if _is_ear(points, ear, left):
            found.append(ear)
            del left[at]
            at, missed = at % len(left), 0
            continue
        at, missed = (at + 1) % len(left), missed + 1
        if missed > len(left):
            raise crossing
    a, b, c = left
    if _cross(points[a], points[b], points[c]) < 0:
        raise crossing
    return [*found, (a, b, c)], tests


def _is_ear(points: Sequence[Point], ear: tuple[int, int, int], left: Sequence[int]) -> bool:
    """Return whether a corner that juts out has no other corner of the polygon in its triangle."""
    a, b, c = (points[corner] for corner in ear)
    if _cross(a, b, c) < 0:
        return False
    own = (a, b, c)
    return not any(
        _cross(a, b, points[other]) >= 0
        and _cross(b, c, points[other]) >= 0
        and _cross(c, a, points[other]) >= 0
        and points[other] not in own
        for other in left
    )


def _cross(a: Point, b: Point, c: Point) -> float:
    """Return twice the area of a triangle, negative if it is clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _turning(points: Sequence[Point]) -> float:
    """Return the sum of a polygon's outer angles: one turn, unless it crosses itself."""
    own = [p for p, before in zip(points, [points[-1], *points], strict=False) if p != before]
    after = [*own[1:], *own[:1]]
    edges = [(q[0] - p[0], q[1] - p[1]) for p, q in zip(own, after, strict=True)]
    return sum(
        math.atan2(u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1])
        for u, v in zip(edges, [*edges[1:], *edges[:1]], strict=True)
    )
