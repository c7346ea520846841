"""The plain: beyond its edge, the stage slopes down to a level plane up to the horizon.

What is narrow along the edge, such as the walls of a crater that it cuts, fades within a fraction
of its width; it would go on outward as a trench.

Colour is rendered from triangles. Depth and labels are cast at the triangles of the slope and at
the infinite level plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.surroundings.border import BorderContinuation, border_of
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.scene import Ground

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


def plain_around(stage: Ground) -> FarGroundMesh:
    """Return the plain around a stage, level at the height of the lowest point of its edge."""
    x0, y0, x1, y1 = stage.extent_m
    half_m = np.array(((x1 - x0) / 2, (y1 - y0) / 2))
    centre_m = np.array((x0, y0)) + half_m
    along = np.linspace(0.0, 1.0, EDGE_POINTS, endpoint=False)
    t, one = 2 * along - 1, np.ones(EDGE_POINTS)
    sides = ((t, -one), (one, t), (-t, one), (-one, -t))
    edge = np.concatenate([np.column_stack(side) for side in sides])
    border = border_of(stage)
    starts = np.cumsum((0, *border.cells, border.cells[0]))
    counts = np.array((*border.cells, *border.cells))
    places = (starts[:, None] + along * counts[:, None]).ravel()
    continuation = BorderContinuation(border)
    lowest_m = float(border.height_m.min())

    scale = np.array((*SLOPE, *LEVEL))[:, None]
    share = np.clip((scale - 1.0) / (FLAT_AT - 1.0), 0.0, 1.0)
    offset_m = np.maximum(scale[:, 0] - 1.0, 0.0) * half_m.min()
    height_m = np.array([continuation.at(each, places) for each in offset_m])
    z = (height_m - lowest_m) * (1.0 - share) ** 2 * (1.0 + 2.0 * share)
    # Rays meet the level plane wherever it is higher.
    z = lowest_m + np.maximum(z, 0.0)
    z[0] -= SUNK_M
    xy = centre_m + scale[..., None] * edge * half_m
    vertices_m = np.concatenate((xy, z[..., None]), axis=-1).reshape(-1, 3).astype(np.float32)
    triangles = _between_rings(len(scale), len(edge))
    return FarGroundMesh(
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
