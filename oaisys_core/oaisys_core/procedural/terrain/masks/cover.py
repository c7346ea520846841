"""How plants cover the ground: in tufts and cushions, denser where it is moist and not steep.

Stones and soils change gradually, and the relief of their textures makes the grain of their border.
Plants do not: each point is green or bare. They thin out to single tufts, over as many metres as
the place changes, so the scores of their layers have noise of the size of tufts.
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from oaisys_core.procedural.terrain.masks.relief import Relief
from oaisys_core.procedural.terrain.noise import Field, band
from oaisys_core.scene.terrain_material import PbrMaps
from oaisys_core.types import FloatArray

WAVES_M = 0.35, 4.0
"""Shortest and longest waves: tufts and cushions are half as wide, up to some 2 m."""

DEVIATION = 1.8
"""Standard deviation of tufts with the softest borders, in units of that of patches."""

WIDEST = 0.4
"""Width of the softest border of a tuft, in standard deviations of patches."""

UNSEEN_WIDTH = sqrt(2) / 1.7
"""Width of the logistic function that a share follows where two noises of deviation 1 are not seen:
a normal distribution of deviation 1 is within 1 % of a logistic one of the width 1 / 1.7."""

MOISTURE_STRENGTH = 1.5
"""Change of a green layer's score from the driest to the wettest place."""

BARE_RAD = 0.55, 0.95
"""Slopes from which on roots hold less and less, 32 degrees, and hardly at all, 54."""

STEEP_STRENGTH = 3.0
"""Change of a green layer's score on the steepest ground."""

SNOW_ALBEDO = 0.6
"""Least reflectance of snow in each channel: salt and limestone have less in blue."""


def is_green(maps: PbrMaps) -> bool:
    """Return whether a texture is of plants: whether its mean colour has more green than red."""
    red, green, blue = maps.mean_of_texels()
    return bool(green > max(red, blue))


def is_snowy(maps: PbrMaps) -> bool:
    """Return whether a texture is of snow: whether it reflects more than other ground does."""
    return bool(min(maps.mean_of_texels()) > SNOW_ALBEDO)


def tuft_deviation(sharpness: float) -> float:
    """Return the standard deviation of the noise of tufts, in units of that of patches."""
    return DEVIATION * (1 - sharpness)


def tuft_softness(sharpness: float, visible: FloatArray | float) -> FloatArray:
    """Return the width of borders of plants, in standard deviations of the scores of patches.

    Args:
        sharpness: Sharpness of the borders, 0 to 1.
        visible: Share of the variance of tufts that is seen; what is not widens the borders.
    """
    of_tuft = WIDEST * (1 - sharpness) ** 1.5 + 1e-3
    unseen = UNSEEN_WIDTH * tuft_deviation(sharpness) * np.sqrt(1 - np.asarray(visible))
    return np.asarray(np.hypot(of_tuft, unseen))


def cover_softness(sharpness: float, texel_m: FloatArray | float, has_plants: bool) -> FloatArray:
    """Return `tuft_softness` of masks with texels of a size; snow alone has no tufts to be seen."""
    visible = visible_share(texel_m) if has_plants else np.ones_like(texel_m, np.float64)
    return tuft_softness(sharpness, visible)


def visible_share(texel_m: FloatArray | float) -> FloatArray:
    """Return the share of the variance of tufts that texels of a size can show."""
    shortest_m, longest_m = WAVES_M
    seen_m = np.clip(2 * np.asarray(texel_m), shortest_m, longest_m)
    return np.asarray(np.log(longest_m / seen_m) / log(longest_m / shortest_m))


def tufts(size_px: int, texel_m: float, rng: np.random.Generator) -> Field:
    """Return (size_px, size_px) noise of tufts with the variance that such texels can show."""
    extent_m = size_px * texel_m
    shortest_m, longest_m = WAVES_M
    field = band(size_px, extent_m / longest_m, extent_m / shortest_m, rng)
    return field * np.float32(np.sqrt(visible_share(texel_m)))


def habitat(relief: Relief, moisture: Field) -> Field:
    """Return (M, M) by how much the ground favours plants, in standard deviations of patches.

    Args:
        relief: Of M x M texels.
        moisture: (M, M) from 0, the driest place, to 1.
    """
    least_rad, most_rad = BARE_RAD
    steep = np.clip((relief.slope_rad - least_rad) / (most_rad - least_rad), 0, 1)
    score = MOISTURE_STRENGTH * (moisture - 0.5) - STEEP_STRENGTH * steep
    return np.asarray(score, np.float32)
