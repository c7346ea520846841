"""Lamps: light sources beside sun and sky."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from oaisys_core.geometry import xyz
from oaisys_core.scene.sky import Color
from oaisys_core.types import FloatArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Lamp:
    """A lamp that is on; what its numbers mean is in `LampConfig`.

    Attributes:
        frame: Frame of position and directions.
        forward: Unit vector in which a spot or area lamp shines.
        right: Unit vector along the width of an area lamp, perpendicular to ``forward``.
        color: Linear colour.
        radius_m: Radius of a point or spot lamp.
        cone_rad: Full angle of a spot's cone.
        cone_softness: Share of the cone over which a spot fades.
        width_m, height_m: Edge lengths of an area lamp.
    """

    name: str
    kind: Literal["point", "spot", "area"]
    frame: Literal["map", "base_link"]
    position_m: Vector
    forward: Vector
    right: Vector
    strength_w: float
    color: Color
    radius_m: float = 0.0
    cone_rad: float = 0.0
    cone_softness: float = 0.0
    width_m: float = 0.0
    height_m: float = 0.0

    @property
    def up(self) -> Vector:
        """Unit vector along the height of an area lamp."""
        return xyz(np.cross(self.right, self.forward))

    def in_map(self, T_map_base: FloatArray | None) -> Lamp:
        """Return the lamp in ``map``.

        Args:
            T_map_base: (4, 4) pose of the rig; only lamps on the rig need it.
        """
        if self.frame == "map" or T_map_base is None:
            return self
        R, t = T_map_base[:3, :3], T_map_base[:3, 3]
        return replace(
            self,
            frame="map",
            position_m=xyz(R @ self.position_m + t),
            forward=xyz(R @ self.forward),
            right=xyz(R @ self.right),
        )
