"""Meshes of broken rock that lie in walls: beds and joints with ledges, corners and gaps."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field, fractal
from oaisys_core.procedural.terrain.processes.exact import smooth
from oaisys_core.scene import HeightField, MeshPrototype
from oaisys_core.types import FloatArray

GRID = 40
"""Points along an edge."""

BEDS = (0.34, 0.15, 0.07)
"""Mean thickness of the beds of each size, in the width of a mesh."""

LENGTH = 1.5
"""Mean distance of the joints across a bed, in its thickness."""

GAPS = 0.35, 1.6
"""Least gap between joints, or thickness of beds, and how much more it may be, in the mean."""

STANDS_OUT, BED_STANDS_OUT = 0.22, 0.14
"""Largest distance by which a block, and a bed as a whole, stands out or back, in its thickness."""

TILT, OVERHANG = 0.16, 0.05
"""Largest tilt of a block's face along either axis, and the mean one by which it leans out."""

BEND, BEND_BEDS = (0.8, 0.45), 4.0
"""By how much joints and beds bend, and the wavelength of it, in the thickness."""

GRAIN, GRAIN_WAVES = 0.004, 24.0
"""Amplitude of the finest unevenness, and its waves across the mesh."""

RIM, RIM_BEND = 0.72, 0.2
"""Distance from the middle, in half the width, from which on a mesh falls back, and by how much
this differs from place to place."""

DEPTH, OUT = 0.45, 0.12
"""How deep in the wall the edge of a mesh is at least, and how far its middle stands out, in its
width."""

DEEPEST = 1.1
"""How far a mesh falls back at most, in the way from `RIM` to half its width."""

CREASE_RAD = radians(28.0)
"""Angle between triangles from which the edge between them is shaded sharp."""

WALL_RAD, LEDGE_RAD, LEDGE_CELLS = radians(54.0), radians(34.0), 1.5
"""Steepness of a wall, in the mean, and up to which snow and soil lie on the ledges in it; and the
standard deviation, in cells, of the rounding after which these are looked for."""


def make_rock_face(name: str, rng: np.random.Generator) -> MeshPrototype:
    """Return a piece of a wall, 1 m wide: x along its beds, y up the wall, z out of it.

    Its edge is below z = -0.4, and its middle about `OUT` above.

    Args:
        name: Of the mesh.
        rng: Draws beds and joints.
    """
    axis = np.linspace(-0.5, 0.5, GRID)
    x, y = np.meshgrid(axis, axis)
    out = OUT + GRAIN * _noise(x, y, 1 / GRAIN_WAVES, rng)
    for thickness in BEDS:
        out += _blocks(x, y, thickness, rng)
    # Between a circle and a square, so that meshes side by side leave few gaps.
    away = 2 * np.sqrt(np.sqrt(np.square(x * x) + np.square(y * y)))
    away *= 1 + RIM_BEND * _noise(x, y, 0.2, rng)
    fall = np.clip((away - RIM) / (1 - RIM), 0, DEEPEST)
    out -= DEPTH * fall * fall
    on_edge = np.maximum(np.abs(x), np.abs(y)) > 0.5 - 0.5 / GRID
    out = np.where(on_edge, np.minimum(out, -DEPTH), out)
    surface = HeightField(out.astype(np.float32), (-0.5, -0.5), 1 / (GRID - 1))
    vertices_m, triangles = surface.vertices_m(), surface.triangles()
    return MeshPrototype(name, vertices_m, triangles, crease_rad=CREASE_RAD)


def bare_and_ledges(face: MeshPrototype) -> tuple[MeshPrototype, MeshPrototype]:
    """Return the steep triangles of a rock face in a wall, and the ledges in it."""
    # Of the larger beds: snow on each step of a hand's width would be rows of stitches.
    points_m = face.vertices_m.astype(np.float64).reshape(GRID, GRID, 3)
    points_m[..., 2] = smooth(points_m[..., 2], LEDGE_CELLS)
    corners = points_m.reshape(-1, 3)[face.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = normals @ (0.0, sin(WALL_RAD), cos(WALL_RAD))
    is_ledge = up > cos(LEDGE_RAD) * np.linalg.norm(normals, axis=1)
    return _part(face, ~is_ledge), _part(face, is_ledge)


def _part(face: MeshPrototype, is_in: NDArray[np.bool_]) -> MeshPrototype:
    used, triangles = np.unique(face.triangles[is_in], return_inverse=True)
    corners = triangles.reshape(-1, 3).astype(np.int32)
    return replace(face, vertices_m=face.vertices_m[used], triangles=corners)


def _blocks(x: FloatArray, y: FloatArray, thickness: float, rng: np.random.Generator) -> FloatArray:
    """Return how far (rows, cols) points stand out on blocks between beds and joints of a size."""
    across, up = (
        each + share * thickness * _noise(x, y, BEND_BEDS * thickness, rng)
        for each, share in zip((x, y), BEND, strict=True)
    )
    beds = thickness * _places(2 / thickness, rng) - 1.0
    bed = np.searchsorted(beds, up)
    joints = _places(3 / (LENGTH * thickness) + len(beds), rng)
    shift = rng.uniform(0, len(beds), len(beds) + 1)
    along = (across + 1) / (LENGTH * thickness) + shift[bed]
    _, block = np.unique(
        bed * (len(joints) + 1) + np.searchsorted(joints, along), return_inverse=True
    )
    block = block.reshape(x.shape)
    count = int(block.max()) + 1
    cells = np.bincount(block.ravel(), minlength=count)
    middle = [np.bincount(block.ravel(), each.ravel(), count) / cells for each in (x, y)]
    drawn = rng.uniform(-1, 1, (count, 3))
    of_bed = BED_STANDS_OUT * rng.uniform(-1, 1, len(beds) + 1)[bed]
    level = thickness * (STANDS_OUT * drawn[:, 0][block] + of_bed)
    tilt = TILT * drawn[:, 1:] + (0.0, OVERHANG)
    for axis, each in enumerate((x, y)):
        level = level + tilt[:, axis][block] * (each - middle[axis][block])
    return np.asarray(level)


def _places(length: float, rng: np.random.Generator) -> FloatArray:
    """Return the places of joints up to a length, some close, some far apart; their mean is 1."""
    least, more = GAPS
    drawn = rng.random(int(length / least) + 2)
    places = np.cumsum(least + more * drawn * np.sqrt(drawn))
    return np.asarray(places[: int(np.searchsorted(places, length)) + 1])


def _noise(x: FloatArray, y: FloatArray, wave: float, rng: np.random.Generator) -> Field:
    u, v = (((each + 1) / wave).astype(np.float32) for each in (x, y))
    return fractal(u, v, rng, octaves=3)
