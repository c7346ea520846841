"""Which kind of ground surrounds a stage."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import Literal

from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.land import land_around
from oaisys_core.procedural.terrain.surroundings.octaves import Shaper
from oaisys_core.procedural.terrain.surroundings.plain import plain_around
from oaisys_core.raycast.solids import flat_ground
from oaisys_core.scene import Ground

EARTH_RADIUS_M = 6.371e6
"""Mean radius."""

LOW_SUN_RAD = radians(10.0)
"""From this elevation on, the sun is above any hill that is longer than the stage."""

MIN_SUN_RAD = radians(2.0)
"""Below this elevation of the sun, hills become no lower."""

HIGHEST_SHARE = 0.5
"""Greatest elevation of hills beyond the stage, as a share of that of a low sun."""


@dataclass(frozen=True)
class Surroundings:
    """What surrounds a stage.

    Attributes:
        kind: ``land`` or ``plain``; exactly flat ground is surrounded by a plain in any case.
        seed: Seed of the land.
        body_radius_m: Radius of the body whose curvature the land has.
        lowest_sun_rad: Lowest elevation of the sun, below which hills beyond the stage stay; None
            for no limit.
        shaped_by: What made the land's forms.
    """

    kind: Literal["land", "plain"] = "plain"
    seed: int = 0
    body_radius_m: float = EARTH_RADIUS_M
    lowest_sun_rad: float | None = None
    shaped_by: Shaper = "water"

    def is_land(self, stage: Ground) -> bool:
        """Return whether land surrounds a stage."""
        return self.kind == "land" and flat_ground(stage) is None

    def around(self, stage: Ground, before: FarGroundMesh | None) -> FarGroundMesh:
        """Return the ground around a stage; ``before`` itself if it is around the same one."""
        if before is not None and before.stage is stage:
            return before
        if self.is_land(stage):
            return land_around(
                stage, self.seed, self.body_radius_m, self._highest_rad, self.shaped_by
            )
        return plain_around(stage)

    @property
    def _highest_rad(self) -> float | None:
        """The elevation above which no hill of the land may rise."""
        if self.lowest_sun_rad is None or self.lowest_sun_rad >= LOW_SUN_RAD:
            return None
        return HIGHEST_SHARE * max(self.lowest_sun_rad, MIN_SUN_RAD)
