"""Rock meshes: spheres cut by planes, squeezed, and roughened by noise.

Broken rocks have edges along which their meshes have vertices, so that facets stay plane.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import cos, pi, radians, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class RockStyle:
    """The parameters of a kind of rock.

    Attributes:
        joints: Number of pairs of about parallel planes that cut it, as rock breaks along joints.
        facets: Number of planes in any direction that cut it in addition.
        joint_cut, cut: (least, most) distances of these planes from the centre of the unit sphere.
        edge: Softness of the edges; with 0 they are sharp.
        axes: (least, most) length of the second and third axis relative to the first.
        lumps: Amplitude of the coarse noise, before the planes cut.
        grain: Amplitude of the fine noise.
        ledges: Depth of horizontal layers.
    """

    joints: int
    facets: int
    joint_cut: tuple[float, float]
    cut: tuple[float, float]
    edge: float
    axes: tuple[tuple[float, float], tuple[float, float]]
    lumps: float
    grain: float
    ledges: float


NO_JOINTS = (1.0, 1.0)

STYLES = {
    "angular": RockStyle(
        3, 12, (0.45, 0.75), (0.6, 0.95), 0.0, ((0.7, 0.95), (0.5, 0.8)), 0.12, 0.022, 0.02
    ),
    "rounded": RockStyle(
        0, 9, NO_JOINTS, (0.66, 0.92), 0.10, ((0.62, 0.92), (0.4, 0.7)), 0.08, 0.005, 0.0
    ),
    "slab": RockStyle(
        3, 10, (0.55, 0.8), (0.68, 0.95), 0.0, ((0.6, 0.9), (0.22, 0.36)), 0.10, 0.018, 0.04
    ),
    "boulder": RockStyle(
        2, 10, (0.55, 0.8), (0.66, 0.92), 0.0, ((0.75, 0.95), (0.65, 0.9)), 0.16, 0.018, 0.02
    ),
    "pebble": RockStyle(
        0, 5, NO_JOINTS, (0.78, 0.95), 0.16, ((0.7, 0.95), (0.45, 0.75)), 0.06, 0.0, 0.0
    ),
}

JOINT_SPREAD = 0.28
"""Standard deviation of the components of a joint's normal about the normal of its set."""

CREASE_RAD = radians(24.0)
"""Angle between triangles of a broken rock from which the edge between them is shaded sharp."""

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
    lumps = Waves.random(rng, frequency=2.5, octaves=3)
    planes = _draw_planes(style, rng)

    def reaches(directions: FloatArray) -> FloatArray:
        """Return the inverse radii of all planes, and of the body that they cut, at directions."""
        body = 1 + style.lumps * lumps.at(directions)
        return np.column_stack((directions @ planes.T, 1 / body))

    if style.edge:
        radius = _soft_radius(reaches(directions), style.edge)
    else:
        directions = directions_on_edges(directions, triangles, reaches)
        radius = 1 / reaches(directions).max(axis=1)
    radius *= 1 + style.ledges * _layers(directions[:, 2] * radius, rng)
    radius *= 1 + style.grain * Waves.random(rng, frequency=11.0, octaves=2).at(directions)
    axes = np.array([1.0, rng.uniform(*style.axes[0]), rng.uniform(*style.axes[1])])
    points = directions * radius[:, None] * axes
    low, high = points.min(axis=0), points.max(axis=0)
    points -= ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    points /= (high - low).max()
    crease_rad = pi if style.edge else CREASE_RAD
    return MeshPrototype(
        kind, points.astype(np.float32), triangles, dust_m=DUST_M, crease_rad=crease_rad
    )


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


def _draw_planes(style: RockStyle, rng: np.random.Generator) -> FloatArray:
    """Return (P, 3) normals of the planes that cut a rock, over their distances from its centre."""
    normals = rng.normal(size=(style.facets, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    planes = normals / rng.uniform(*style.cut, style.facets)[:, None]
    if not style.joints:
        return np.asarray(planes)
    # Upright sets stand about at right angles to the bedding, as joints in layered rock do.
    angle = rng.uniform(0, pi)
    sets = np.array([(0, 0, 1), (cos(angle), sin(angle), 0), (-sin(angle), cos(angle), 0)])
    joints = np.concatenate((sets[: style.joints], -sets[: style.joints]))
    joints = joints + JOINT_SPREAD * rng.normal(size=joints.shape)
    joints /= np.linalg.norm(joints, axis=1, keepdims=True)
    return np.concatenate((planes, joints / rng.uniform(*style.joint_cut, len(joints))[:, None]))


def _soft_radius(reaches: FloatArray, edge: float) -> FloatArray:
    """Return (N,) radii of what (N, P) inverse radii bound, with rounded edges between them."""
    bounded = 1 / np.maximum(reaches, 1e-3)
    # A soft minimum rounds the edges between facets.
    nearest = bounded.min(axis=1, keepdims=True)
    soft = np.exp(-(bounded - nearest) / edge).sum(axis=1)
    return np.asarray(nearest[:, 0] - edge * np.log(soft))


def directions_on_edges(
    directions: FloatArray,
    triangles: NDArray[np.int32],
    reaches: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return (N, 3) directions of vertices, those next to an edge between facets moved onto it.

    Where the ends of a side of a triangle are on different facets, the nearer end moves to the
    point of the side at which both have the same radius; the mean of those, if there are several.

    Args:
        directions: (N, 3) unit vectors.
        triangles: (T, 3) vertex indices.
        reaches: Returns (N, P) inverse radii of the facets' planes; the largest is the surface's.
    """
    inverse = reaches(directions)
    facet = inverse.argmax(axis=1)
    first, second = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]).T
    # Each side belongs to two triangles, one of which has it in this direction.
    crosses = (facet[first] != facet[second]) & (first < second)
    first, second = first[crosses], second[crosses]
    one, other = facet[first], facet[second]
    lead = inverse[first, one] - inverse[first, other]
    lag = inverse[second, other] - inverse[second, one]
    share = (lead / np.maximum(lead + lag, 1e-12))[:, None]
    crossing = directions[first] * (1 - share) + directions[second] * share
    mover = np.where(share[:, 0] < 0.5, first, second)
    count = np.bincount(mover, minlength=len(directions))
    moves = count > 0
    mean = [np.bincount(mover, axis, minlength=len(directions)) for axis in crossing.T]
    moved = directions.copy()
    moved[moves] = (np.column_stack(mean) / np.maximum(count, 1)[:, None])[moves]
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def _layers(height: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return how far horizontal layers protrude, -1 to 1, at heights of -1 to 1."""
    borders = np.sort(rng.uniform(-1, 1, 10))
    levels = rng.uniform(-1, 1, 11)
    steps = 0.5 + 0.5 * np.tanh((height[:, None] - borders) / 0.03)
    return np.asarray(levels[0] + steps @ np.diff(levels))


class Waves(NamedTuple):
    """Smooth noise of about -1 to 1 on the unit sphere: a sum of waves in random directions.

    Attributes:
        waves: (octaves, 12, 3) wave vectors.
        phases: (octaves, 12).
    """

    waves: FloatArray
    phases: FloatArray

    @classmethod
    def random(cls, rng: np.random.Generator, frequency: float, octaves: int) -> Waves:
        """Return noise of some octaves, the first with waves of a mean square ``frequency``."""
        waves, phases = np.empty((octaves, 12, 3)), np.empty((octaves, 12))
        for octave in range(octaves):
            waves[octave] = rng.normal(size=(12, 3)) * frequency * 2**octave
            phases[octave] = rng.uniform(0, 2 * np.pi, 12)
        return cls(waves, phases)

    def at(self, directions: FloatArray) -> FloatArray:
        """Return the (N,) noise at (N, 3) unit vectors."""
        total = np.zeros(len(directions))
        for octave, (waves, phases) in enumerate(zip(self.waves, self.phases, strict=True)):
            total += np.cos(directions @ waves.T + phases).mean(axis=1) * 0.55**octave
        return total * 2
