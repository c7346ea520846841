"""How deep stones lie in the ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import MeshPrototype
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

MAX_BURIED = 0.8
"""Largest share of an object's height below the ground, so that every object is visible."""

FOOT_SHARE = 0.12
"""Least share of a stone's surface below level ground: about that of a ball sunk by as much."""

REACH_CHUNK = 4096
"""Number of things of one shape whose points are turned at once."""


def sunk_shares(sink: tuple[float, float], count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count,) shares of heights below the ground: half in the lowest eighth of a range.

    Most stones lie on the ground, and a few have been buried.
    """
    low, high = sink
    u = rng.uniform(size=count)
    return np.asarray(low + (high - low) * u * u * u)


def resting_depth_m(
    rotation: Rotation,
    sizes_m: FloatArray,
    sunk: FloatArray,
    hollow_m: FloatArray,
    shapes: Sequence[MeshPrototype],
    shape_of: NDArray[np.int64],
) -> FloatArray:
    """Return (N,) depths of the origins of things below level ground.

    Args:
        rotation: N rotations of the things.
        sizes_m: (N,) sizes.
        sunk: (N,) shares of their heights, as they lie, that are below the ground.
        hollow_m: (N,) depths of the ground below them.
        shapes: As `scatter_on` takes them.
        shape_of: (N,) indices into them.
    """
    low, foot, high = _reach(rotation.as_matrix()[:, 2], shapes, shape_of)
    height = high - low
    # What leans, or has an uneven foot, would stand on an edge.
    depth = np.maximum(sunk * height + low, foot) + hollow_m / sizes_m
    return np.asarray(sizes_m * np.minimum(depth, MAX_BURIED * height + low))


def _reach(
    up: FloatArray, shapes: Sequence[MeshPrototype], shape_of: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (N,) heights above their origins of the lowest points of shapes, of their feet, below
    which `FOOT_SHARE` of their points are, and of their highest points.

    Args:
        up: (N, 3) upward directions in the frames of the shapes.
        shapes, shape_of: As `scatter_on` takes and returns them.
    """
    low, foot, high = np.zeros(len(up)), np.zeros(len(up)), np.ones(len(up))
    for index, shape in enumerate(shapes):
        x, y, z = shape.vertices_m.T.astype(np.float64)
        chosen = np.flatnonzero(shape_of == index)
        for start in range(0, len(chosen), REACH_CHUNK):
            some = chosen[start : start + REACH_CHUNK]
            a, b, c = up[some].T[:, :, None]
            heights = a * x + b * y + c * z
            low[some], high[some] = heights.min(axis=1), heights.max(axis=1)
            place = int(FOOT_SHARE * len(x))
            foot[some] = np.partition(heights, place, axis=1)[:, place]
    return low, foot, high
