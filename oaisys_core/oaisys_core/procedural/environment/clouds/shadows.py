"""Shadows of clouds: the share of sunlight that they let through to each point below them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import cos, radians, sin, tan

import numpy as np

from oaisys_core.procedural.environment.clouds.daylight import spread_share
from oaisys_core.procedural.environment.clouds.depths import MIN_SUN_RAD
from oaisys_core.procedural.environment.clouds.dome import dome_under
from oaisys_core.procedural.environment.clouds.field import GRID, TILE_SIZES
from oaisys_core.procedural.environment.clouds.scattering import diffuse_share
from oaisys_core.procedural.environment.clouds.tile import Tile
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.scene.sky import Sky
from oaisys_core.types import FloatArray

LEAST_SUN_RAD = radians(0.25)
"""Elevation from which on the sun shines through clouds; a lower one shines below them."""


@dataclass(frozen=True, eq=False)
class CloudShadows:
    """Shadows that repeat as the clouds do.

    Light that broken clouds scatter downwards counts as sunlight from the sun's direction (Bohren
    1987, see `diffuse_share`), so that the ground gets as much of it in all as below real clouds.
    Below a closed layer it comes from the whole sky, see `daylight`.

    Attributes:
        share: (GRID, GRID) of sunlight, where a ray to the sun meets the clouds' undersides; texel
            (0, 0) is at the place ``shift_m``.
        tile_m: Edge of the square that repeats.
        base_m: Height of the undersides.
        per_m: How far a ray to the sun leads along x and y for each metre up.
        shift_m: x and y of the first texel: a sun lower than `MIN_SUN_RAD` has the shadows of one
            that is as high.
    """

    share: Field
    tile_m: float
    base_m: float
    per_m: tuple[float, float]
    shift_m: tuple[float, float]

    @cached_property
    def _tile(self) -> Tile:
        return Tile(self.share)

    def at(self, points_m: FloatArray) -> Field:
        """Return the (N,) shares at (N, 3) points; above the undersides, they are 1."""
        rise_m = self.base_m - points_m[:, 2]
        x, y = (
            ((points_m[:, axis] + rise_m * per_m - shift_m) * (GRID / self.tile_m))
            for axis, (per_m, shift_m) in enumerate(zip(self.per_m, self.shift_m, strict=True))
        )
        found = self._tile.at(_within(x), _within(y))
        return np.where(rise_m > 0, found, np.float32(1))


@lru_cache(maxsize=2)
def cloud_shadows(sky: Sky) -> CloudShadows | None:
    """Return the shadows of a sky's clouds; None if there are none."""
    if not sky.shows_clouds or not sky.lamp_w_m2 or sky.sun_elevation_rad < LEAST_SUN_RAD:
        return None
    clouds = sky.clouds
    if clouds is None or not clouds.shadows:
        return None
    azimuth_rad, elevation_rad = sky.sun_azimuth_rad, sky.sun_elevation_rad
    per_m = 1 / tan(elevation_rad)
    too_far_m = clouds.base_m * (per_m - 1 / tan(max(elevation_rad, MIN_SUN_RAD)))
    to_sun, spread = dome_under(sky, clouds).to_sun, np.float32(spread_share(clouds))
    return CloudShadows(
        (1 - spread) * diffuse_share(to_sun) + spread * np.exp(-to_sun),
        clouds.size_m * TILE_SIZES,
        clouds.base_m,
        (per_m * cos(azimuth_rad), per_m * sin(azimuth_rad)),
        (too_far_m * cos(azimuth_rad), too_far_m * sin(azimuth_rad)),
    )


def _within(texels: FloatArray) -> Field:
    """Return places on the first tile, before they lose digits in float32."""
    return np.asarray(np.mod(texels, GRID), np.float32)
