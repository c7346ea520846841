"""Cushions of moss: a dome with heads of their own size.

`moss_cushion` is a `PlantBuilder`.
"""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.plants.growth import GOLDEN_RAD
from oaisys_core.procedural.scatter.plants.organ_sizes import ORGANS
from oaisys_core.procedural.scatter.plants.organs import mix_colors
from oaisys_core.procedural.scatter.rocks import icosphere
from oaisys_core.types import FloatArray

MAX_HEADS = 4000
"""Largest number of heads, at any size."""

COVER = 1.0
"""Heads of a cushion of 1 m, times the square of their width in metres."""

MOSS, MOSS_TOP, MOSS_OLD = (0.22, 0.28, 0.09), (0.50, 0.56, 0.24), (0.56, 0.52, 0.26)


def moss_cushion(rng: np.random.Generator, unit_m: float, size_m: float) -> MeshBuilder:
    """Return a low dome covered with small heads; a larger one has more."""
    parts = MeshBuilder()
    directions, triangles = icosphere(3)
    lobes, phases = rng.normal(size=(7, 3)) * (1.0, 1.0, 0.3), rng.uniform(0, 6, 7)
    around = rng.normal(size=3), rng.uniform(0, 6)

    def points_of(ways: FloatArray) -> FloatArray:
        radius = 1 + 0.22 * np.cos(ways @ lobes.T * 2.0 + phases).mean(axis=1)
        points: FloatArray = ways * radius[:, None] * (0.5, 0.5, 0.24)
        points[:, 2] = np.maximum(points[:, 2], -0.04) + 0.04
        return points

    def top_of(ways: FloatArray) -> FloatArray:
        patch = 0.5 + 0.5 * np.cos(ways @ around[0] * 3 + around[1])
        return mix_colors(np.array(MOSS_TOP), MOSS_OLD, 0.35 * patch[:, None])

    light = 0.6 * (0.55 + 0.45 * np.clip(directions[:, 2], 0, 1))
    dome = mix_colors(np.array(MOSS), top_of(directions), light[:, None])
    parts.add(points_of(directions), triangles, dome)

    head = ORGANS["moss_cushion"]["head"]
    count = int(np.clip(COVER * size_m**2 / head.mean_width_m**2, 60, MAX_HEADS))
    ways = _upward(rng, count)
    heights, widths = head.draw(count, rng, unit_m)
    # The dome is wider than high: its normals are steeper than the directions of its points.
    normals = ways * (1.0, 1.0, 2.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    _add_heads(parts, points_of(ways), normals, heights, widths, top_of(ways), rng)
    return parts


def _upward(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) unit vectors, spread evenly over the upper half of a flat dome."""
    height = rng.uniform(-0.1, 1.0, count)
    angle = np.arange(count) * GOLDEN_RAD + rng.normal(0, 0.3, count)
    level = np.sqrt(1 - height**2)
    return np.column_stack((level * np.cos(angle), level * np.sin(angle), height))


def _add_heads(
    parts: MeshBuilder,
    feet: FloatArray,
    normals: FloatArray,
    heights: FloatArray,
    widths: FloatArray,
    tops: FloatArray,
    rng: np.random.Generator,
) -> None:
    """Add cones of six sides, light at their tips: (N, 3) feet, normals and colours, (N,) sizes."""
    side = np.cross(normals, rng.normal(size=normals.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(normals, side)
    angle = np.arange(6) * np.pi / 3
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    base = feet[:, None] + 0.5 * widths[:, None, None] * ring
    corners = np.concatenate((base, (feet + heights[:, None] * normals)[:, None]), axis=1)
    corner = np.arange(6)
    faces = np.column_stack((corner, (corner + 1) % 6, np.full(6, 6)))
    triangles = (faces + 7 * np.arange(len(feet))[:, None, None]).reshape(-1, 3)
    shade = np.r_[np.full(6, 0.75), 1.08][:, None] * rng.uniform(0.85, 1.1, (len(feet), 1, 1))
    parts.add(corners.reshape(-1, 3), triangles, (tops[:, None] * shade).reshape(-1, 3))
