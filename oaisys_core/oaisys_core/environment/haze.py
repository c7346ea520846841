"""Dust and haze (aerial perspective)."""

from __future__ import annotations

from math import log

import numpy as np

from oaisys_core.color import linear
from oaisys_core.config.environment import HazeConfig
from oaisys_core.environment.draws import Draws
from oaisys_core.sky import Haze

LEAST_CONTRAST = 0.02
"""Contrast at the visual range, by definition of the term (Koschmieder 1924)."""

WAVELENGTHS_NM = np.array((680.0, 550.0, 440.0))
"""That red, green and blue stand for; visual range is that of green."""


def haze_of(config: HazeConfig | None, draws: Draws) -> Haze | None:
    """Return the haze that a configuration asks for."""
    if config is None:
        return None
    visibility_m = draws.number("haze.visibility_m", config.visibility_m)
    exponent = draws.number("haze.angstrom_exponent", config.angstrom_exponent)
    at_green = -log(LEAST_CONTRAST) / visibility_m
    red, green, blue = (at_green * (WAVELENGTHS_NM / WAVELENGTHS_NM[1]) ** -exponent).tolist()
    if config.color_srgb is None:
        return Haze((red, green, blue))
    veil_red, veil_green, veil_blue = linear(config.color_srgb).tolist()
    return Haze((red, green, blue), (veil_red, veil_green, veil_blue))
