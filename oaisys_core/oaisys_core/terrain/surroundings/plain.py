"""The plain: beyond its edge, the stage slopes down to a level plane up to the horizon.

Colour is rendered from triangles. Depth and labels are cast at the triangles of the slope and at
the infinite level plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import Ground
from oaisys_core.terrain.surroundings.far_ground import FarGround

EDGE_POINTS = 192
"""Points along each edge of the stage."""

FLAT_AT = 3.0
"""Where the plain becomes level: distance from the stage's centre, in units of its edge's."""

FARTHEST = 2000.0
"""Where its triangles end, in the same units; from eye height the rim coincides with the horizon.
"""

SLOPE = (0.9995, 1.0, 1.0, 1.03, 1.08, 1.15, 1.25, 1.4, 1.6, 1.85, 2.1, 2.4, 2.7, FLAT_AT)
LEVEL = (10.0, FARTHEST)
"""Distances of the rings of vertices, in the same units. Two rings lie on the stage's edge, so that
the sunk one does not tilt the normals of the plain."""

SUNK_M = 0.3
"""Depth of the innermost ring below the stage's edge, so that no gap shows between the two."""


def plain_around(stage: Ground) -> FarGround:
    """Return the plain around a stage, level at the height of the lowest point of its edge."""
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

    scale = np.array((*SLOPE, *LEVEL))[:, None]
    share = np.clip((scale - 1.0) / (FLAT_AT - 1.0), 0.0, 1.0)
    z = lowest_m + (height_m - lowest_m) * (1.0 - share) ** 2 * (1.0 + 2.0 * share)
    z[0] -= SUNK_M
    xy = centre_m + scale[..., None] * edge * half_m
    vertices_m = np.concatenate((xy, z[..., None]), axis=-1).reshape(-1, 3).astype(np.float32)
    triangles = _between_rings(len(scale), len(edge))
    return FarGround(
        stage=stage,
        vertices_m=vertices_m,
        triangles=triangles,
        inner_share=SLOPE[0],
        level_m=float(vertices_m[len(SLOPE) * len(edge) - 1, 2]),
        cast_triangles=2 * (len(SLOPE) - 2) * len(edge),
    )


def _between_rings(rings: int, points: int) -> NDArray[np.int32]:
    """Return (T, 3) triangles between concentric rings, counter-clockwise from above.

    There are none between the two rings on the stage's edge.
    """
    index = np.arange(rings * points, dtype=np.int32).reshape(rings, points)
    a, b = (np.delete(each, 1, axis=0) for each in (index[:-1], index[1:]))
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    corners = np.stack((a, b, b_next, a, b_next, a_next), axis=-1).reshape(-1, 3)
    return np.asarray(corners, dtype=np.int32)
