"""Where on a body a ground lies."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Georeference:
    """Where ``map`` lies on a body.

    Attributes:
        wkt: Reference system, x to the east (or along its first axis) and y to the north.
        map_to_system: (a, b, c, d, e, f): x = a·x_m + b·y_m + c and y = d·x_m + e·y_m + f of a
            point (x_m, y_m) in ``map``, in the system's units.
        height_offset_m: Height in ``map`` of a point whose elevation is 0.
    """

    wkt: str
    map_to_system: tuple[float, float, float, float, float, float]
    height_offset_m: float

    def with_offset(self, x_m: float, y_m: float) -> Georeference:
        """Return the same with the ground moved by so much in ``map``."""
        a, b, c, d, e, f = self.map_to_system
        moved = (a, b, c - a * x_m - b * y_m, d, e, f - d * x_m - e * y_m)
        return Georeference(self.wkt, moved, self.height_offset_m)
