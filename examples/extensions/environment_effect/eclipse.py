"""An environment effect: the Moon covers part of the sun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oaisys_core.config.section import Range
from oaisys_core.procedural.environment.effects import EnvironmentEffect
from oaisys_core.scene.sky import Sky


class Eclipse(EnvironmentEffect):
    """Dims sun and sky by the share of the sun that is covered.

    Attributes:
        covered: Range of that share.
    """

    covered: Range = (0.5, 0.95)

    def apply(self, sky: Sky, rng: np.random.Generator) -> Sky:
        """Return the dimmed sky."""
        left = 1.0 - rng.uniform(*self.covered)
        return replace(
            sky,
            sun_strength_w_m2=sky.sun_strength_w_m2 * left,
            sky_strength=sky.sky_strength * left,
        )
