"""Rock meshes: spheres cut by planes, squeezed, and roughened by noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class RockStyle:
    """The parameters of a kind of rock.

    Attributes:
        facets: Number of planes that cut it.
        cut: (least, most) distance of a plane from the centre of the unit sphere.
        edge: Softness of the edges; 0 is sharp.
        axes: (least, most) length of the second and third axis relative to the first.
        lumps: Amplitude of the coarse noise, before the planes cut.
        grain: Amplitude of the fine noise.
        ledges: Depth of horizontal layers.
    """

    facets: int
    cut: tuple[float, float]
    edge: float
    axes: tuple[tuple[float, float], tuple[float, float]]
    lumps: float
    grain: float
    ledges: float


STYLES = {
    "angular": RockStyle(20, (0.6, 0.86), 0.022, ((0.7, 0.95), (0.5, 0.8)), 0.12, 0.010, 0.01),
    "rounded": RockStyle(9, (0.72, 0.92), 0.10, ((0.75, 0.95), (0.55, 0.8)), 0.08, 0.005, 0.0),
    "slab": RockStyle(16, (0.66, 0.88), 0.022, ((0.6, 0.9), (0.22, 0.36)), 0.10, 0.007, 0.03),
    "boulder": RockStyle(16, (0.64, 0.9), 0.035, ((0.75, 0.95), (0.65, 0.9)), 0.16, 0.008, 0.02),
    "pebble": RockStyle(5, (0.78, 0.95), 0.16, ((0.7, 0.95), (0.45, 0.75)), 0.06, 0.0, 0.0),
}

DUST_M = 0.15
"""Height of the dust and fines on a rock, at a size of 1 m."""

MAX_SUBDIVISIONS = {"pebble": 1}
"""Limits for kinds that are scattered by the thousand."""

ROCK_KINDS = frozenset(STYLES)


def make_rock(kind: str, rng: np.random.Generator, subdivisions: int) -> MeshPrototype:
    """Return a closed rock mesh, 1 m along its longest axis, the centre of its base at the origin.

    Args:
        kind: One of `ROCK_KINDS`.
        rng: Draws its shape.
        subdivisions: n of the icosahedron, for 20 * 4**n triangles; pebbles have at most 80.

    Raises:
        InvalidInputError: There is no such kind.
    """
    return fine_rock(kind, rng, min(subdivisions, MAX_SUBDIVISIONS.get(kind, subdivisions)))


def fine_rock(kind: str, rng: np.random.Generator, subdivisions: int) -> MeshPrototype:
    """Return `make_rock` with as many triangles as are asked for.

    Raises:
        InvalidInputError: There is no such kind.
    """
    if kind not in STYLES:
        raise InvalidInputError("kind", kind, one_of(ROCK_KINDS, kind))
    style = STYLES[kind]
    directions, triangles = icosphere(subdivisions)
    body = 1 + style.lumps * _waves(directions, rng, frequency=2.5, octaves=3)
    radius = _cut_radius(directions, body, style, rng)
    radius *= 1 + style.ledges * _layers(directions[:, 2] * radius, rng)
    radius *= 1 + style.grain * _waves(directions, rng, frequency=11.0, octaves=2)
    axes = np.array([1.0, rng.uniform(*style.axes[0]), rng.uniform(*style.axes[1])])
    points = directions * radius[:, None] * axes
    low, high = points.min(axis=0), points.max(axis=0)
    points -= ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    points /= (high - low).max()
    return MeshPrototype(kind, points.astype(np.float32), triangles, dust_m=DUST_M)


@cache
def icosphere(subdivisions: int) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return unit vectors and outward triangles of an icosahedron subdivided n times."""
    g = (1 + 5**0.5) / 2
    # The corners of three perpendicular golden rectangles.
    corners = "-1 g 0|1 g 0|-1 -g 0|1 -g 0|0 -1 g|0 1 g|0 -1 -g|0 1 -g|g 0 -1|g 0 1|-g 0 -1|-g 0 1"
    value = {"0": 0.0, "1": 1.0, "-1": -1.0, "g": g, "-g": -g}
    points = np.array([[value[v] for v in corner.split()] for corner in corners.split("|")])
    points /= np.linalg.norm(points[0])
    faces = "0b5 051 017 07a 0ab 159 5b4 ba2 a76 718 394 342 326 368 389 495 24b 62a 867 981"
    triangles = np.array([[int(c, 16) for c in face] for face in faces.split()], np.int32)
    for _ in range(subdivisions):
        points, triangles = _subdivide(points, triangles)
    for array in (points, triangles):
        array.flags.writeable = False
    return points, triangles


def _subdivide(
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


def _cut_radius(
    directions: FloatArray, body: FloatArray, style: RockStyle, rng: np.random.Generator
) -> FloatArray:
    """Return the radius of the body in each direction after planes have cut it."""
    normals = rng.normal(size=(style.facets, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distance = rng.uniform(*style.cut, style.facets)
    cosine = directions @ normals.T
    reach = np.where(cosine > 1e-3, distance / np.maximum(cosine, 1e-3), np.inf)
    reach = np.minimum(reach, 1.0 / 1e-3)
    bounded = np.column_stack((reach, body))
    # A soft minimum rounds the edges between facets.
    nearest = bounded.min(axis=1, keepdims=True)
    soft = np.exp(-(bounded - nearest) / style.edge).sum(axis=1)
    return np.asarray(nearest[:, 0] - style.edge * np.log(soft))


def _layers(height: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return how far horizontal layers protrude, -1 to 1, at heights of -1 to 1."""
    borders = np.sort(rng.uniform(-1, 1, 10))
    levels = rng.uniform(-1, 1, 11)
    steps = 0.5 + 0.5 * np.tanh((height[:, None] - borders) / 0.03)
    return np.asarray(levels[0] + steps @ np.diff(levels))


def _waves(
    directions: FloatArray, rng: np.random.Generator, frequency: float, octaves: int
) -> FloatArray:
    """Return smooth noise of about -1 to 1 on the sphere, a sum of waves in random directions."""
    total = np.zeros(len(directions))
    for octave in range(octaves):
        wave = rng.normal(size=(12, 3)) * frequency * 2**octave
        phase = rng.uniform(0, 2 * np.pi, 12)
        total += np.cos(directions @ wave.T + phase).mean(axis=1) * 0.55**octave
    return total * 2
