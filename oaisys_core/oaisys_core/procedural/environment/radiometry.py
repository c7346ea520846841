"""Brightness in physical units: the bands of radiance images, and what a scene unit is in them.

Cycles and the analytic backend compute in scene units, in which a sun of `STANDARD_SUN` lights a
surface that faces it. Such a sun is as bright as the body's: its irradiance in each band is that
above the air, at the body's mean distance from the sun.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.sky import Color, Sky

BANDS_NM = {"red": (600.0, 700.0), "green": (500.0, 600.0), "blue": (400.0, 500.0)}
"""Limits of the bands; within them a sensor counts all light alike."""

SOLAR_IRRADIANCE_W_M2 = (158.77, 184.68, 186.52)
"""Of red, green and blue above the air at 1 au: the extraterrestrial spectrum of ASTM G173-03,
integrated over `BANDS_NM`."""

STANDARD_SUN = 4.0
"""``environment.sun_strength_w_m2`` at which the sun is as bright as it is at the body."""


def unit_w_m2(distance_au: float) -> Color:
    """Return the irradiance in red, green and blue of one scene unit.

    Args:
        distance_au: The body's mean distance from the sun, at which a standard sun shines.
    """
    red, green, blue = (each / (STANDARD_SUN * distance_au**2) for each in SOLAR_IRRADIANCE_W_M2)
    return (red, green, blue)


def radiance_w_m2_sr(radiance: NDArray[Any], sky: Sky) -> NDArray[np.float32]:
    """Return the (H, W, 3) radiance in W/(m² sr) of one in scene units."""
    return np.asarray(radiance[..., :3] * np.array(sky.unit_w_m2, np.float32), np.float32)
