"""Meshes seen from above, by rays: what is laid over a tile at any size and heading."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.scatter.rocks import fine_rock
from oaisys_core.raycast.triangles import TriangleTarget
from oaisys_core.types import FloatArray, TriangleMesh

OUTSIDE = -1.0
"""Height where a ray hits nothing, in units of the radius; far below what is seen of a mesh."""

CAST_PX = 88
"""Rays along an edge of a stamp: as many as the largest stones have texels across."""

MIN_PX = 12
"""Rays along an edge of the smallest level."""

ROCKS, SUBDIVISIONS = 20, 4
"""Shapes of a kind of rock, and how fine their meshes are, see `fine_rock`."""

LEAN_RAD = 0.3
"""Standard deviation of how far stones lean from lying flat."""


class MeshStamps(NamedTuple):
    """Heights of meshes, seen from above.

    A stamp is a square of two radii, the larger half extent of its mesh along x or y, about its
    middle; row 0 is at the largest y. Heights are in units of that radius above its lowest point.

    Attributes:
        levels: (K, S, S) float32 heights of K meshes, `OUTSIDE` where nothing is hit; each level
            has half the resolution of the one before.
        top: (K,) largest height.
        share: (K,) share of the square that is covered.
    """

    levels: tuple[NDArray[np.float32], ...]
    top: NDArray[np.float32]
    share: FloatArray

    def level_for(self, radius_px: float) -> NDArray[np.float32]:
        """Return the coarsest level with a ray for each of 2 * ``radius_px`` texels, or level 0."""
        fitting = [level for level in self.levels if level.shape[1] >= 2 * radius_px]
        return fitting[-1] if fitting else self.levels[0]


def cast_stamps(meshes: Sequence[TriangleMesh], cast_px: int = CAST_PX) -> MeshStamps:
    """Cast meshes from above."""
    import cv2

    heights = np.stack([cast_from_above(mesh, cast_px) for mesh in meshes])
    levels = [heights]
    while (size := levels[-1].shape[1] // 2) >= MIN_PX:
        smaller = [cv2.resize(each, (size, size), interpolation=cv2.INTER_AREA) for each in heights]
        levels.append(np.stack(smaller).astype(np.float32))
    share = (heights > OUTSIDE).mean(axis=(1, 2))
    return MeshStamps(tuple(levels), heights.max(axis=(1, 2)), share)


def cast_from_above(mesh: TriangleMesh, cast_px: int) -> NDArray[np.float32]:
    """Return the (S, S) heights of a mesh, see `MeshStamps`."""
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    radius = float((high - low)[:2].max()) / 2
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    target = TriangleTarget([TriangleMesh((mesh.vertices_m - middle) / radius, mesh.triangles)])
    axis = (np.arange(cast_px) + 0.5) * (2 / cast_px) - 1
    x, y = np.meshgrid(axis, -axis)
    from_m = target.top_m + 1.0
    origins = np.stack((x, y, np.full_like(x, from_m)), axis=-1).reshape(-1, 3)
    down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
    distance = target.intersect(origins, down)[0].reshape(x.shape)
    return np.where(np.isfinite(distance), from_m - distance, OUTSIDE).astype(np.float32)


@cache
def cast_rocks(kind: str) -> MeshStamps:
    """Cast `ROCKS` rocks of a kind, the same for all sets, each leaning a little from lying flat.

    Args:
        kind: See `fine_rock`.
    """
    rng = randomness.stream(0, f"stamps/{kind}")
    return cast_stamps([_lying(kind, rng, SUBDIVISIONS) for _ in range(ROCKS)])


def _lying(kind: str, rng: np.random.Generator, subdivisions: int) -> TriangleMesh:
    rock = fine_rock(kind, rng, subdivisions)
    turn = scipy.spatial.transform.Rotation.from_rotvec([*rng.normal(0, LEAN_RAD, 2), 0.0])
    return TriangleMesh(turn.apply(rock.vertices_m.astype(np.float64)), rock.triangles)
