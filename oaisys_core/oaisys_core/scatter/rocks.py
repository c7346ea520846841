"""Rock meshes made from a sphere: facets cut by planes, squeezed, and roughened by noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class RockStyle:
    """What tells one kind of rock from another.

    Attributes:
        facets: How many planes cut it.
        cut: (least, most) distance of a plane from the centre, the sphere's radius being 1.
        edge: Softness of the facets' edges; 0 is sharp.
        axes: (least, most) length of the second and third axis relative to the first.
        lumps, grain: Height of coarse and fine unevenness.
    """

    facets: int
    cut: tuple[float, float]
    edge: float
    axes: tuple[tuple[float, float], tuple[float, float]]
    lumps: float
    grain: float


STYLES = {
    "angular": RockStyle(16, (0.55, 0.85), 0.015, ((0.65, 0.95), (0.5, 0.8)), 0.05, 0.012),
    "rounded": RockStyle(7, (0.75, 0.95), 0.16, ((0.75, 0.95), (0.55, 0.8)), 0.07, 0.006),
    "slab": RockStyle(12, (0.6, 0.85), 0.02, ((0.6, 0.9), (0.22, 0.36)), 0.04, 0.010),
    "boulder": RockStyle(20, (0.62, 0.9), 0.05, ((0.75, 0.95), (0.65, 0.9)), 0.10, 0.016),
}

ROCK_KINDS = frozenset(STYLES)


def make_rock(kind: str, rng: np.random.Generator, subdivisions: int) -> MeshPrototype:
    """Return a closed rock mesh whose longest axis is 1 m, its base's centre at the origin.

    Args:
        kind: One of `ROCK_KINDS`.
        rng: Gives its shape.
        subdivisions: Of the icosahedron: 20 * 4**n triangles.

    Raises:
        InvalidInputError: There is no such kind.
    """
    if kind not in STYLES:
        raise InvalidInputError("kind", kind, f"one of {', '.join(sorted(ROCK_KINDS))}")
    style = STYLES[kind]
    directions, triangles = icosphere(subdivisions)
    radius = _cut_radius(directions, style, rng)
    radius *= 1 + style.lumps * _waves(directions, rng, frequency=2.5, octaves=3)
    radius *= 1 + style.grain * _waves(directions, rng, frequency=11.0, octaves=3)
    axes = np.array([1.0, rng.uniform(*style.axes[0]), rng.uniform(*style.axes[1])])
    points = directions * radius[:, None] * axes
    low, high = points.min(axis=0), points.max(axis=0)
    points -= ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    points /= (high - low).max()
    return MeshPrototype(kind, points.astype(np.float32), triangles)


def icosphere(subdivisions: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return unit vectors and outward triangles of an icosahedron subdivided n times."""
    g = (1 + 5**0.5) / 2
    # The corners of three golden rectangles at right angles to one another.
    corners = "-1 g 0|1 g 0|-1 -g 0|1 -g 0|0 -1 g|0 1 g|0 -1 -g|0 1 -g|g 0 -1|g 0 1|-g 0 -1|-g 0 1"
    value = {"0": 0.0, "1": 1.0, "-1": -1.0, "g": g, "-g": -g}
    points = np.array([[value[v] for v in corner.split()] for corner in corners.split("|")])
    points /= np.linalg.norm(points[0])
    faces = "0b5 051 017 07a 0ab 159 5b4 ba2 a76 718 394 342 326 368 389 495 24b 62a 867 981"
    triangles = np.array([[int(c, 16) for c in face] for face in faces.split()], np.int32)
    for _ in range(subdivisions):
        points, triangles = _subdivided(points, triangles)
    return points, triangles


def _subdivided(
    points: FloatArray, triangles: NDArray[np.int32]
) -> tuple[FloatArray, NDArray[np.int32]]:
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, middle = np.unique(edges, axis=0, return_inverse=True)
    middles = points[unique].sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = (middle.reshape(-1, 3) + len(points)).T
    a, b, c = triangles.T
    split = np.stack((a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca), axis=1)
    return np.vstack((points, middles)), split.reshape(-1, 3).astype(np.int32)


def _cut_radius(directions: FloatArray, style: RockStyle, rng: np.random.Generator) -> FloatArray:
    """Return how far the sphere reaches in each direction after planes cut pieces off it."""
    normals = rng.normal(size=(style.facets, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distance = rng.uniform(*style.cut, style.facets)
    cosine = directions @ normals.T
    reach = np.where(cosine > 1e-3, distance / np.maximum(cosine, 1e-3), np.inf)
    reach = np.minimum(reach, 1.0 / 1e-3)
    bounded = np.column_stack((reach, np.ones(len(directions))))
    if style.edge == 0:
        return np.asarray(bounded.min(axis=1))
    # A soft minimum rounds the edges between facets.
    nearest = bounded.min(axis=1, keepdims=True)
    soft = np.exp(-(bounded - nearest) / style.edge).sum(axis=1)
    return np.asarray(nearest[:, 0] - style.edge * np.log(soft))


def _waves(
    directions: FloatArray, rng: np.random.Generator, frequency: float, octaves: int
) -> FloatArray:
    """Return smooth noise of about -1 to 1 on the sphere: a sum of waves in random directions."""
    total = np.zeros(len(directions))
    for octave in range(octaves):
        wave = rng.normal(size=(12, 3)) * frequency * 2**octave
        phase = rng.uniform(0, 2 * np.pi, 12)
        total += np.cos(directions @ wave.T + phase).mean(axis=1) * 0.55**octave
    return total * 2
