"""How far above the land's triangles rays to the sun begin.

The land's triangles are large and shaded as if they were smooth. Where light grazes them, those
that lean away from the sun would lie in the shadow of the next ones, in patches as large as they.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.draft.appearance import Floats
from oaisys_core.scene import FarGround

GRAZING_COS = 0.2
"""Cosine of the sun's angle to the ground below which rays begin higher above it; above the land's
triangles, by their edges times how much less it is."""


class FarLift:
    """The heights for the triangles of one land under one sun."""

    def __init__(self) -> None:
        self._far_ground: FarGround | None = None
        self._to_sun: tuple[float, float, float] | None = None
        self._lift_m = np.zeros(0, np.float32)

    def take_over(self, far_ground: FarGround, to_sun: tuple[float, float, float]) -> None:
        """Prepare the heights, unless they are known."""
        if far_ground is self._far_ground and to_sun == self._to_sun:
            return
        self._far_ground, self._to_sun = far_ground, to_sun
        triangles = far_ground.triangles[: far_ground.cast_triangles]
        a, b, c = (far_ground.vertices_m[corner] for corner in triangles.T)
        normal = np.cross(b - a, c - a)
        twice_m2 = np.linalg.norm(normal, axis=1)
        facing = normal @ np.array(to_sun, np.float32) / np.maximum(twice_m2, 1e-12)
        self._lift_m = np.sqrt(twice_m2) * np.clip(GRAZING_COS - facing, 0, 1)

    def of(self, elements: NDArray[np.int64]) -> Floats:
        """Return the (N,) heights for hits on elements of the land; 0 beyond its triangles."""
        is_known = elements < len(self._lift_m)
        found = self._lift_m[np.where(is_known, elements, 0)]
        return np.asarray(np.where(is_known, found, 0), np.float32)
