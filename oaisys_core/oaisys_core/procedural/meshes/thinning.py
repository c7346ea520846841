"""Plants with fewer triangles, for those that are seen from afar.

Some leaves are left out and the others made larger, so that the leaves' area stays (Cook, Halstead,
Planck and Ryu, "Stochastic Simplification of Aggregate Detail", ACM Trans. Graph. 26(3), 2007).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.scene import MeshPrototype

STEM_TRIANGLES = 12
"""Connected triangles from which a part is a stem rather than a leaf, and is kept as it is."""

LARGEST_FACTOR = 4.0
"""Largest factor on the length of a leaf."""


def thin_out(plant: MeshPrototype, most_triangles: int, rng: np.random.Generator) -> MeshPrototype:
    """Return a plant with fewer leaves; itself if it has few triangles, no leaves, or textures.

    Args:
        plant: A mesh whose leaves share no vertices.
        most_triangles: About how many triangles it may have; stems may be more.
        rng: Draws which leaves stay.
    """
    count = len(plant.triangles)
    if count <= most_triangles or plant.uv is not None:
        return plant
    part_of_vertex, size_of_part = _parts(plant)
    is_leaf = size_of_part < STEM_TRIANGLES
    leaves = int(size_of_part[is_leaf].sum())
    if not leaves:
        return plant
    left = max(most_triangles - (count - leaves), leaves / LARGEST_FACTOR**2)
    share = min(left / leaves, 1.0)
    is_kept = ~is_leaf | (rng.uniform(size=len(size_of_part)) < share)
    vertices_m = _enlarged(plant.vertices_m, part_of_vertex, is_leaf, share**-0.5)
    return _some(replace(plant, vertices_m=vertices_m), is_kept[part_of_vertex])


def _parts(plant: MeshPrototype) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the (V,) connected part of each vertex, and the (P,) numbers of their triangles."""
    corners, count = plant.triangles, len(plant.vertices_m)
    ends = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
    edges = scipy.sparse.coo_matrix((np.ones(len(ends[0]), np.int8), ends), (count, count))
    number, part_of_vertex = scipy.sparse.csgraph.connected_components(edges, directed=False)
    return part_of_vertex, np.bincount(part_of_vertex[corners[:, 0]], minlength=number)


def _enlarged(
    vertices_m: NDArray[np.float32],
    part_of_vertex: NDArray[np.int32],
    is_leaf: NDArray[np.bool_],
    factor: float,
) -> NDArray[np.float32]:
    """Return (V, 3) vertices with leaves made larger about their centres."""
    size = np.bincount(part_of_vertex)
    sums = [np.bincount(part_of_vertex, weights=axis) for axis in vertices_m.T]
    centres = (np.stack(sums, axis=1) / size[:, None])[part_of_vertex]
    factors = np.where(is_leaf, factor, 1.0)[part_of_vertex, None]
    return np.asarray(centres + factors * (vertices_m - centres), np.float32)


def _some(plant: MeshPrototype, is_kept: NDArray[np.bool_]) -> MeshPrototype:
    """Return a plant with some of its (V,) vertices, and the triangles between them."""
    chosen = is_kept[plant.triangles[:, 0]]
    index = np.cumsum(is_kept, dtype=np.int32) - 1
    colors, light = plant.vertex_colors_srgb, plant.translucency
    return replace(
        plant,
        vertices_m=plant.vertices_m[is_kept],
        triangles=index[plant.triangles[chosen]],
        vertex_colors_srgb=None if colors is None else colors[is_kept],
        translucency=None if light is None else light[is_kept],
        needles=None if plant.needles is None else plant.needles[is_kept],
    )
