"""Dust and haze (aerial perspective)."""

from __future__ import annotations

from math import log

import numpy as np

from oaisys_core.color import linear
from oaisys_core.config.sections.environment import HazeConfig
from oaisys_core.environment.draws import Draws
from oaisys_core.sky import Haze

LEAST_CONTRAST = 0.02
"""Contrast at the visual range, by definition of the term (Koschmieder 1924)."""

THICKNESS = 0.1
"""Of the hazy layer, as a share of the visual range, where nobody says: the sun shows through."""

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
    thickness_m = visibility_m * THICKNESS
    if config.thickness_m is not None:
        thickness_m = draws.number("haze.thickness_m", config.thickness_m)
    tint = linear(config.color_srgb)
    tint_red, tint_green, tint_blue = (tint / max(tint.mean(), 1e-6)).tolist()
    return Haze((red, green, blue), thickness_m, (tint_red, tint_green, tint_blue))
