"""The sun near the horizon: how low a configuration lets it, and a warning where hills hide it."""

from __future__ import annotations

import logging
from datetime import timedelta
from math import degrees, radians

import numpy as np

from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.config.sections.stage import Body
from oaisys_core.config.sections.sun import SunFromTimeConfig
from oaisys_core.procedural.environment.sun_in_map import sun_at
from oaisys_core.scene.sky import Sky
from oaisys_core.scene.surroundings import FarGround

TIMES = 97
"""Number of times of day at which the lowest sun is looked for."""

_LOG = logging.getLogger(__name__)


def lowest_sun_rad(config: EnvironmentConfig, body: Body) -> float | None:
    """Return the lowest elevation of the sun that a configuration allows; None if it never rises.

    It is 0 if the sun may also be below the horizon, and where the ground alone knows the place.

    Raises:
        InvalidInputError: The configuration gives a time, and there is no ephemeris of the body.
    """
    at = config.sun_from_time
    if at is None:
        lowest_rad, highest_rad = (radians(each) for each in config.sun_elevation_deg)
    elif at.latitude_deg is None:
        return 0.0
    else:
        elevations_rad = _elevations_rad(at, body)
        lowest_rad, highest_rad = min(elevations_rad), max(elevations_rad)
    return max(lowest_rad, 0.0) if highest_rad > 0 else None


def _elevations_rad(at: SunFromTimeConfig, body: Body) -> list[float]:
    """Return elevations of the sun over the range of times at which a world may begin."""
    return [
        sun_at(at, at.date_time + timedelta(hours=float(later_h)), body, None).elevation_rad
        for later_h in np.unique(np.linspace(*at.later_h, TIMES))
    ]


class LowSunWarning:
    """Warns when hills beyond the stage hide the sun from most of it, once for each new sun."""

    def __init__(self) -> None:
        self._sun_rad: tuple[float, float] | None = None
        self._far_ground: FarGround | None = None

    def check(self, sky: Sky, far_ground: FarGround | None) -> None:
        """Log a warning if the sun is new and below the horizon that the ground makes.

        Args:
            sky: Has the sun.
            far_ground: The ground beyond the stage; None if it is not shown.
        """
        sun_rad = sky.sun_elevation_rad, sky.sun_azimuth_rad
        if sun_rad == self._sun_rad and far_ground is self._far_ground:
            return
        self._sun_rad, self._far_ground = sun_rad, far_ground
        if far_ground is None or sky.lamp_w_m2 <= 0:
            return
        horizon_rad = far_ground.horizon_rad(sky.sun_azimuth_rad)
        if sky.sun_elevation_rad < horizon_rad:
            _LOG.warning(
                "the sun is at %.1f degrees and the ground beyond the stage rises to %.1f degrees "
                "in its direction (azimuth %.0f), so that most of the stage lies in shadow: set "
                "environment.sun_elevation_deg higher, or give the configuration a range of it "
                "that begins as low, to which land adapts, or stage.surroundings: plain",
                degrees(sky.sun_elevation_rad),
                degrees(horizon_rad),
                degrees(sky.sun_azimuth_rad),
            )
