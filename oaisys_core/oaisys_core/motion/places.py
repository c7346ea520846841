"""Motions to random places."""

from __future__ import annotations

import numpy as np

from oaisys_core.config.sections.motion import HoverMotion, RandomMotion
from oaisys_core.motion.base import Motion, Step, at_height, attitude, drawn_from, posed
from oaisys_core.types import Pose

MIDDLE_SHARE = 0.9
"""Share of the stage's edges over which a rig hovers that was not told where."""


class Random(Motion):
    """See `RandomMotion`."""

    can_redraw = True

    def __init__(self, config: RandomMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval

    def pose(self, step: Step) -> Pose | None:
        """See `Motion.pose`."""
        box = np.array([drawn_from(ranges, step.rng) for ranges in self._config.position_m])
        rotation = attitude(self._config, step.rng)
        position_m = at_height(box, self._config, step, step.rng)
        return None if position_m is None else posed(position_m, rotation)


class Hover(Motion):
    """See `HoverMotion`."""

    can_redraw = True
    is_lifted = True

    def __init__(self, config: HoverMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval

    def pose(self, step: Step) -> Pose | None:
        """See `Motion.pose`."""
        x0, y0, x1, y1 = step.ground.extent_m
        x_m = self._config.x_m or _middle(x0, x1)
        y_m = self._config.y_m or _middle(y0, y1)
        place_m = np.array((drawn_from(x_m, step.rng), drawn_from(y_m, step.rng), 0.0))
        rotation = attitude(self._config, step.rng)
        position_m = at_height(place_m, self._config, step, step.rng)
        return None if position_m is None else posed(position_m, rotation)


def _middle(low_m: float, high_m: float) -> tuple[float, float]:
    margin_m = (1 - MIDDLE_SHARE) / 2 * (high_m - low_m)
    return low_m + margin_m, high_m - margin_m
