"""The ground beyond the stage, in colour only: it slopes down to a plain that ends at the horizon.

Depth, labels and meshes know nothing of it.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.blender.meshes import new_mesh, new_object
from oaisys_core.scene import Ground, Scene

EDGE_POINTS = 192
"""Points along each edge of the stage."""

FLAT_AT = 3.0
"""Distance from the stage's centre, in shares of its edge's, from which the plain is level."""

FARTHEST = 2000.0
"""Distance at which it ends, likewise: at eye height its rim and the horizon are one."""

RINGS = np.array([0.995, 1.0, 1.03, 1.08, 1.15, 1.25, 1.4, 1.6, 1.85, 2.1, 2.4, 2.7, FLAT_AT, 10.0])

PLAIN = "plain"
"""Name of the object and its mesh."""

SUNK_M = 0.3
"""Depth of the innermost ring below the stage, whose edge has more points."""


class Plain:
    """What goes on beyond the stage, with the ground's material."""

    def __init__(self) -> None:
        self._thing: Any = None

    def clear(self) -> None:
        """Remove it, so that nothing uses the ground's material any more."""
        if self._thing is not None:
            bpy.data.meshes.remove(self._thing.data)
        self._thing = None

    def build(self, scene: Scene, material: Any) -> None:
        """Make it around a scene's ground."""
        self.clear()
        mesh = new_mesh(PLAIN, *_rings(scene.ground), smooth=True)
        mesh.materials.append(material)
        self._thing = new_object(PLAIN, mesh, np.eye(4))

    def show(self, is_shown: bool) -> None:
        """Let it be seen or not."""
        # To set what is set already has Blender look at the whole scene again.
        if self._thing is not None and self._thing.hide_render == is_shown:
            self._thing.hide_render = not is_shown


def _rings(ground: Ground) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return (V, 3) vertices and (T, 3) triangles around a ground.

    It only falls, from the stage's edge to the edge's lowest point: nothing of it is ever seen
    above the horizon, where labels say sky.
    """
    x0, y0, x1, y1 = ground.extent_m
    half_m = np.array(((x1 - x0) / 2, (y1 - y0) / 2))
    centre_m = np.array((x0, y0)) + half_m
    t = np.linspace(-1.0, 1.0, EDGE_POINTS, endpoint=False)
    one = np.ones(EDGE_POINTS)
    sides = ((t, -one), (one, t), (-t, one), (-one, -t))
    edge = np.concatenate([np.column_stack(side) for side in sides])
    # Just inside, for an edge is no part of every kind of ground.
    height_m = ground.height_at(centre_m + edge * half_m * 0.9999)
    lowest_m = np.nanmin(height_m) if np.isfinite(height_m).any() else 0.0
    height_m = np.where(np.isfinite(height_m), height_m, lowest_m)

    scale = np.append(RINGS, FARTHEST)[:, None]
    share = np.clip((scale - 1.0) / (FLAT_AT - 1.0), 0.0, 1.0)
    z = lowest_m + (height_m - lowest_m) * (1.0 - share) ** 2 * (1.0 + 2.0 * share)
    z[0] -= SUNK_M
    xy = centre_m + scale[..., None] * edge * half_m
    vertices = np.concatenate((xy, z[..., None]), axis=-1).reshape(-1, 3).astype(np.float32)
    return vertices, _between_rings(len(scale), len(edge))


def _between_rings(rings: int, points: int) -> NDArray[np.int32]:
    """Return (T, 3) triangles, counter-clockwise from above, of rings one around the other."""
    index = np.arange(rings * points, dtype=np.int32).reshape(rings, points)
    a, b = index[:-1], index[1:]
    a_next, b_next = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    corners = np.stack((a, b, b_next, a, b_next, a_next), axis=-1).reshape(-1, 3)
    return np.asarray(corners, dtype=np.int32)
