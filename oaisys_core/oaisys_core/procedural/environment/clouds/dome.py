"""Clouds as they are seen from the ground, for all directions above the horizon.

Rays go through a slab of air that is bent around the body. Light is summed up along them from the
farthest slab to the nearest: Beer and Lambert's law for what gets through, sunlight and light of
sky and ground that is scattered towards the eye, and the air's own light before all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, pi, radians, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.environment.clouds.depths import Depths
from oaisys_core.procedural.environment.clouds.field import SLABS, CloudField, Slab
from oaisys_core.procedural.environment.clouds.scattering import (
    diffuse_share,
    in_scattering,
    order_phases,
)
from oaisys_core.procedural.environment.clouds.tile import Tile, look_up
from oaisys_core.procedural.environment.light import PLAIN_ALBEDO, sky_irradiance_w_m2, sun_color
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.scene.sky import Clouds, Sky
from oaisys_core.types import FloatArray

ROWS, COLUMNS = 512, 2048
"""Directions: elevations from the horizon up, azimuths from +x counter-clockwise."""

BAND = 16
"""Rows that are computed at once, so that they fit into the processor's cache."""

GRAIN = np.array((0.2, 0.6, 0.2), np.float32)
"""Weights of neighbours along each axis by which grain is smoothed."""

BODY_M = 6.371e6
"""Radius of the body: a layer of clouds curves down to the horizon."""

VISIBILITY_M = 22_000.0
"""Distance over which air replaces 1 - 1 / e of a cloud's light by the sky's."""

SUN_STEP_RAD = radians(0.5)
"""Steps of the sun between which clouds keep their light, while a sun moves from view to view."""


@dataclass(frozen=True, eq=False)
class CloudDome:
    """What clouds send from all directions above the horizon.

    Row i looks up by pi / 2 * ((i + 0.5) / ROWS)² radians, column j at an azimuth of
    2 pi (j + 0.5) / COLUMNS.

    Attributes:
        lights: (4, ROWS, COLUMNS) radiance by sunlight of 1 W/m², by a sky and by a ground with a
            radiance of 1; and the share of the sky's own radiance behind and before the clouds.
        sunlit: Share of sunlight that reaches the ground, in the mean over all places.
        to_sun: (GRID, GRID) optical depths towards the sun from the clouds' undersides.
    """

    lights: NDArray[np.float32]
    sunlit: float
    to_sun: Field


def cloud_elevations_rad() -> FloatArray:
    """Return the (ROWS,) elevations of the rows of a dome."""
    return np.asarray(pi / 2 * ((np.arange(ROWS) + 0.5) / ROWS) ** 2)


def air_clearness(distance_m: FloatArray) -> FloatArray:
    """Return the share of a cloud's light that gets through the air before it."""
    return np.asarray(np.exp(-distance_m / VISIBILITY_M))


def distances_m(elevations_rad: FloatArray, height_m: float) -> FloatArray:
    """Return the distance of a height above the ground along rays of some elevations."""
    rise_m = BODY_M * np.sin(elevations_rad)
    # Not the difference of two large numbers.
    square = (2 * BODY_M + height_m) * height_m
    return np.asarray(square / (np.sqrt(rise_m**2 + square) + rise_m))


@lru_cache(maxsize=2)
def cloud_image(sky: Sky) -> NDArray[np.float32]:
    """Return the (ROWS, COLUMNS, 4) picture of the clouds of a sky that has some, as `CloudDome`.

    Red, green and blue are the radiance of clouds; the last channel is the share of the radiance
    of the sky that is added to it.
    """
    assert sky.clouds is not None
    dome = dome_under(sky, sky.clouds)
    sun_w_m2 = sky.lamp_w_m2 * np.array(sun_color(sky))
    sky_w_m2 = sky_irradiance_w_m2(sky)
    on_ground_w_m2 = sun_w_m2 * max(sin(sky.sun_elevation_rad), 0.0) * dome.sunlit + sky_w_m2
    colors = np.stack((sun_w_m2, sky_w_m2 / pi, PLAIN_ALBEDO * on_ground_w_m2 / pi))
    image = np.empty((ROWS, COLUMNS, 4), np.float32)
    for channel in range(3):
        of_light = colors[:, channel].astype(np.float32)
        image[..., channel] = sum(
            light * share for light, share in zip(dome.lights[:3], of_light, strict=True)
        )
    image[..., 3] = dome.lights[3]
    return image


def before_sky(sky: Sky, rays: FloatArray, radiance: FloatArray | Field) -> FloatArray:
    """Return the (N, 3) radiance of clouds before a sky of (N, 3) radiance, along (N, 3) rays."""
    found = _seen(sky, rays)
    return np.asarray(found[:, :3] + radiance * found[:, 3:])


def sun_through_clouds(sky: Sky, rays: FloatArray) -> FloatArray:
    """Return the (N,) share of the sun's disc that is seen through clouds, along (N, 3) rays."""
    before = air_before_clouds(sky)
    return np.asarray(np.maximum(_seen(sky, rays)[:, 3] - before, 0.0) / (1 - before))


def air_before_clouds(sky: Sky) -> float:
    """Return the share of the sky's radiance that air before clouds has, towards the sun."""
    assert sky.clouds is not None
    height_m = sky.clouds.base_m + sky.clouds.thickness_m / 2
    elevation_rad = np.array(max(sky.sun_elevation_rad, 0.0))
    return 1 - float(air_clearness(distances_m(elevation_rad, height_m)))


def _seen(sky: Sky, rays: FloatArray) -> NDArray[np.float32]:
    """Return the (N, 4) values of the picture of clouds along (N, 3) rays."""
    level = np.hypot(rays[:, 0], rays[:, 1])
    elevations_rad = np.maximum(np.arctan2(rays[:, 2], level), 0.0)
    rows = np.clip(np.sqrt(elevations_rad * (2 / pi)) * ROWS - 0.5, 0, ROWS - 1)
    columns = np.arctan2(rays[:, 1], rays[:, 0]) * (COLUMNS / (2 * pi)) - 0.5
    around = np.mod(columns.astype(np.float32), np.float32(COLUMNS))
    return look_up(_image_around(sky), around, rows.astype(np.float32))


@lru_cache(maxsize=2)
def _image_around(sky: Sky) -> NDArray[np.float32]:
    """Return the picture of clouds with its first column once more behind the last one."""
    image = cloud_image(sky)
    return np.concatenate((image, image[:, :1]), axis=1)


def dome_under(sky: Sky, clouds: Clouds) -> CloudDome:
    """Return the clouds in the light of a sun near that of the sky; any sun, if it is dark."""
    if not sky.lamp_w_m2:
        return cloud_dome(clouds, pi / 2, 0.0)
    steps = round(sky.sun_elevation_rad / SUN_STEP_RAD), round(sky.sun_azimuth_rad / SUN_STEP_RAD)
    return cloud_dome(clouds, steps[0] * SUN_STEP_RAD, steps[1] * SUN_STEP_RAD)


@lru_cache(maxsize=2)
def cloud_dome(clouds: Clouds, sun_elevation_rad: float, sun_azimuth_rad: float) -> CloudDome:
    """Return what clouds send under a sun; its azimuth is from +x, counter-clockwise."""
    field = CloudField(clouds)
    depths = Depths(field, sun_elevation_rad, sun_azimuth_rad)
    march = _March(field, clouds.base_m, _order_phases(sun_elevation_rad, sun_azimuth_rad))
    for index in reversed(range(SLABS)):
        slab = field.slab(index)
        march.add(slab, index * field.slab_m, depths.next_slab(index, slab))
    sunlit = float(np.exp(-depths.to_sun).mean(dtype=np.float64))
    lights = march.lights.reshape(4, ROWS, COLUMNS)
    smooth = np.stack([_without_grain(light) for light in lights])
    return CloudDome(smooth, sunlit, depths.to_sun)


def _azimuths_rad() -> FloatArray:
    return np.asarray(2 * pi * (np.arange(COLUMNS) + 0.5) / COLUMNS)


def _order_phases(sun_elevation_rad: float, sun_azimuth_rad: float) -> NDArray[np.float32]:
    """Return the (ORDERS, ROWS, COLUMNS) share of sunlight that orders scatter to the eye."""
    up_rad, azimuths_rad = cloud_elevations_rad()[:, None], _azimuths_rad()
    cosines = np.cos(up_rad) * cos(sun_elevation_rad) * np.cos(azimuths_rad - sun_azimuth_rad)
    cosines = cosines + np.sin(up_rad) * sin(sun_elevation_rad)
    return order_phases(cosines.astype(np.float32))


def _offsets() -> Field:
    """Return (ROWS, COLUMNS) heights from -0.5 to 0.5 at which rays look at a slab, in slabs.

    With all at the middle, slabs would show as terraces. Neighbours differ as in interleaved
    gradient noise (Jimenez, "Next generation post processing in Call of Duty", SIGGRAPH 2014).
    """
    row, column = np.arange(ROWS)[:, None], np.arange(COLUMNS)
    found = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    return (found - 0.5).astype(np.float32)


def _without_grain(light: Field) -> Field:
    """Return (ROWS, COLUMNS) light without what `_offsets` leave from one pixel to the next."""
    wrapped = np.concatenate((light[:, -1:], light, light[:, :1]), axis=1)
    return np.asarray(cv2.sepFilter2D(wrapped, -1, GRAIN, GRAIN)[:, 1:-1])


class _March:
    """Sums up light along all rays, one slab at a time, from the farthest.

    Attributes:
        lights: (4, ROWS * COLUMNS) as those of `CloudDome`, of the slabs so far.
    """

    def __init__(self, field: CloudField, base_m: float, phases: NDArray[np.float32]) -> None:
        self._field, self._base_m, self._excess = field, base_m, Tile(field.excess)
        self._phases = phases.reshape(len(phases), -1)
        self._elevations_rad = cloud_elevations_rad()
        azimuths_rad = _azimuths_rad()
        self._aside = np.stack((np.cos(azimuths_rad), np.sin(azimuths_rad))).astype(np.float32)
        self._offsets = _offsets()
        self.lights = np.zeros((4, ROWS * COLUMNS), np.float32)
        self.lights[3] = 1

    def add(self, slab: Slab, above_base_m: float, depths: Tile) -> None:
        """Add the light of a slab before that of those behind it."""
        height_m = self._base_m + above_base_m
        ends_m = [
            distances_m(self._elevations_rad, each)
            for each in (height_m, height_m + self._field.slab_m)
        ]
        middle_m = (ends_m[0] + ends_m[1]) / 2
        ways_m = ends_m[1] - ends_m[0]
        level = np.cos(self._elevations_rad) / self._field.texel_m
        of_rows = (middle_m * level, ways_m * level, ways_m, air_clearness(middle_m))
        for first in range(0, ROWS, BAND):
            rows = slice(first, first + BAND)
            values = tuple(each[rows].astype(np.float32) for each in of_rows)
            self._add_rows(slab, depths, first, values)

    def _add_rows(self, slab: Slab, depths: Tile, first: int, of_rows: tuple[Field, ...]) -> None:
        """Add the light of a slab in some rows.

        ``of_rows`` are the level distances of the slab and of its thickness, in texels, ways
        through the slab, and the air's clearness.
        """
        level, thick, ways_m, clear = of_rows
        offsets = self._offsets[first : first + len(level)]
        away = level[:, None] + thick[:, None] * offsets
        # The map is smooth, so that two neighbours may have the same value.
        half = ((away[:, ::2] * aside[::2]).ravel() for aside in self._aside)
        excess = np.repeat(self._excess.at(*half), 2)
        some = np.flatnonzero(excess > slab.least)
        if not len(some):
            return
        excess = excess[some] - np.float32(slab.growth) * offsets.ravel()[some]
        away, column = away.ravel()[some], some % COLUMNS
        x, y = (away * aside[column] for aside in self._aside)
        extinction = slab.at(excess, x, y)
        is_cloud = extinction > 0
        some, extinction, x, y = some[is_cloud], extinction[is_cloud], x[is_cloud], y[is_cloud]
        row = some // COLUMNS
        to_sun, above, below = depths.at(x, y).T
        passed = np.exp(-extinction * ways_m[row])
        clear = clear[row]
        rays = some + first * COLUMNS
        # What a slab scatters over its way, weakened by the slab itself.
        held = (1 - passed) * clear
        lights = self.lights[:, rays] * passed
        lights[0] += held * in_scattering(to_sun, self._phases[:, rays])
        lights[1] += held * (np.float32(0.5) * diffuse_share(above))
        lights[2] += held * (np.float32(0.5) * diffuse_share(below))
        # The air before clouds is as bright as the sky there.
        lights[3] += (1 - passed) * (1 - clear)
        self.lights[:, rays] = lights
