"""The far plain: the ground beyond the stage slopes down to a level plane up to the horizon.

Colour is rendered from its triangles (see `rings`). Depth and labels are cast at the triangles of
the slope and at the infinite level plane. The ground truth mesh ends with the stage.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.raycast.triangles import NO_ELEMENT, RayTarget, TriangleTarget
from oaisys_core.scene import Ground
from oaisys_core.terrain.detail import DetailedGround
from oaisys_core.types import FloatArray, TriangleMesh

EDGE_POINTS = 192
"""Points along each edge of the stage."""

FLAT_AT = 3.0
"""Where the plain becomes level: distance from the stage's centre, in units of its edge's."""

FARTHEST = 2000.0
"""Where its triangles end, in the same units; from eye height the rim coincides with the horizon.
"""

SLOPE = (0.9995, 1.0, 1.03, 1.08, 1.15, 1.25, 1.4, 1.6, 1.85, 2.1, 2.4, 2.7, FLAT_AT)
LEVEL = (10.0, FARTHEST)
"""Distances of the rings of vertices, in the same units."""

SUNK_M = 0.3
"""Depth of the innermost ring below the stage's edge, so that no gap shows between the two."""


class FarPlainTarget(RayTarget):
    """The far plain as a ray target; heights are defined on the stage only, so that it has none.

    Attributes:
        stage: The ground that it surrounds.
    """

    top_m = -np.inf

    def __init__(self, stage: Ground) -> None:
        """Build the slope around a stage, see `stage_of`."""
        self.stage = stage
        vertices_m, triangles = rings(stage, SLOPE)
        self._slope = TriangleTarget([TriangleMesh(vertices_m.astype(np.float64), triangles)])
        self._level_element = len(triangles)
        self._level_m = float(vertices_m[-1, 2])
        x0, y0, x1, y1 = stage.extent_m
        self._low_m, self._high_m = np.array((x0, y0)), np.array((x1, y1))
        self._inset_m = (self._high_m - self._low_m) / 2 * (1 - SLOPE[0])

    def intersect(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """See `RayTarget`; ``directions`` are (R, 3)."""
        found = np.full(len(directions), np.inf)
        elements = np.full(len(directions), NO_ELEMENT, np.int64)
        rays = np.flatnonzero(self._may_meet(origins_m, directions, limits))
        if not len(rays):
            return found, elements
        origins = origins_m if origins_m.ndim == 1 else origins_m[rays]
        slope_m, slope_elements = self._slope.intersect(origins, directions[rays])
        level_m = self._to_level(origins, directions[rays])
        found[rays] = np.minimum(slope_m, level_m)
        elements[rays] = np.where(level_m < slope_m, self._level_element, slope_elements)
        return found, elements

    def normals_of(self, elements: NDArray[np.int64], points_m: FloatArray) -> FloatArray:
        """See `RayTarget`."""
        normals = np.tile((0.0, 0.0, 1.0), (len(elements), 1))
        of_slope = elements != self._level_element
        normals[of_slope] = self._slope.normals_of(elements[of_slope], points_m[of_slope])
        return normals

    def instance_ids_of(self, elements: NDArray[np.int64]) -> NDArray[np.uint32]:
        """Return zeros: it is ground."""
        return np.zeros(elements.shape, np.uint32)

    def _may_meet(
        self, origins_m: FloatArray, directions: FloatArray, limits: FloatArray | None
    ) -> NDArray[np.bool_]:
        """Return (R,) which rays may hit it: those that leave the stage before their limit."""
        low, high = self._low_m + self._inset_m, self._high_m - self._inset_m
        xy = origins_m[..., :2]
        may = np.asarray((origins_m[..., 2] <= self._slope.top_m) | (directions[:, 2] < 0))
        if (xy < low).any() or (xy > high).any():
            return may
        along = directions[:, :2]
        with np.errstate(divide="ignore", invalid="ignore"):
            leaves = (np.where(along > 0, high, low) - xy) / along
        leaves[along == 0] = np.inf
        return np.asarray(may & (leaves.min(axis=1) < (np.inf if limits is None else limits)))

    def _to_level(self, origins_m: FloatArray, directions: FloatArray) -> FloatArray:
        """Return (R,) distances to the level plane outside the stage, ``+inf`` for a miss."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t = (self._level_m - origins_m[..., 2]) / directions[:, 2]
            xy = origins_m[..., :2] + t[:, None] * directions[:, :2]
        outside = ((xy < self._low_m) | (xy > self._high_m)).any(axis=1)
        return np.where((t > 0) & np.isfinite(t) & outside, t, np.inf)


def stage_of(ground: Ground) -> Ground:
    """Return the ground without the detail near the cameras, which does not change its edge."""
    return ground.coarse if isinstance(ground, DetailedGround) else ground


def rings(
    stage: Ground, scales: tuple[float, ...]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return (V, 3) vertices and (T, 3) triangles of rings around a stage.

    They descend from the stage's edge to the height of the edge's lowest point.

    Args:
        stage: See `stage_of`.
        scales: Distances of the rings from the stage's centre, in units of its edge's.
    """
    x0, y0, x1, y1 = stage.extent_m
    half_m = np.array(((x1 - x0) / 2, (y1 - y0) / 2))
    centre_m = np.array((x0, y0)) + half_m
    t = np.linspace(-1.0, 1.0, EDGE_POINTS, endpoint=False)
    one = np.ones(EDGE_POINTS)
    sides = ((t, -one), (one, t), (-t, one), (-one, -t))
    edge = np.concatenate([np.column_stack(side) for side in sides])
    # Sampled just inside, because not every kind of ground has heights on its edge.
    height_m = stage.height_at(centre_m + edge * half_m * 0.9999)
    lowest_m = np.nanmin(height_m) if np.isfinite(height_m).any() else 0.0
    height_m = np.where(np.isfinite(height_m), height_m, lowest_m)

    scale = np.array(scales)[:, None]
    share = np.clip((scale - 1.0) / (FLAT_AT - 1.0), 0.0, 1.0)
    z = lowest_m + (height_m - lowest_m) * (1.0 - share) ** 2 * (1.0 + 2.0 * share)
    z[0] -= SUNK_M
    xy = centre_m + scale[..., None] * edge * half_m
    vertices = np.concatenate((xy, z[..., None]), axis=-1).reshape(-1, 3).astype(np.float32)
    return vertices, _between_rings(len(scale), len(edge))


def _between_rings(rings: int, points: int) -> NDArray[np.int32]:
    """Return (T, 3) triangles between concentric rings, counter-clockwise from above."""
    index = np.arange(rings * points, dtype=np.int32).reshape(rings, points)
    a, b = index[:-1], index[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    corners = np.stack((a, b, b_next, a, b_next, a_next), axis=-1).reshape(-1, 3)
    return np.asarray(corners, dtype=np.int32)
