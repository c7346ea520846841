"""Light of the sky, by the direction of a surface."""

from __future__ import annotations

from math import cos, pi, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.environment import atmosphere
from oaisys_core.procedural.environment.clouds.daylight import daylight_factors
from oaisys_core.procedural.environment.clouds.dome import before_sky, sun_through_clouds
from oaisys_core.procedural.environment.light import plain_radiance, sun_color
from oaisys_core.render.draft.appearance import Floats, empty, zeros
from oaisys_core.render.draft.ground.texture_atlas import sample
from oaisys_core.render.shading.shading import MIN_UP, in_haze
from oaisys_core.scene.sky import Sky, gradient_radiance, texels_at
from oaisys_core.types import FloatArray

RINGS, SECTORS = 48, 64
"""Directions over which light is summed up: equal steps of the vertical component, of azimuth."""

COSINE_LOBE = (pi, 2 * pi / 3, pi / 4)
"""Share of each band of spherical harmonics that a surface receives (Ramamoorthi and Hanrahan, "An
Efficient Representation for Irradiance Environment Maps", SIGGRAPH 2001)."""


FADE_BELOW = 3.3
"""How fast a clear sky fades below the horizon, by the ray's vertical component."""


MIN_DISC_RAD = 1e-4
"""Least radius of the sun's disc in images: a point would be infinitely bright."""


class SkyLight:
    """Radiance of the sky, and the irradiance of surfaces by it."""

    def __init__(self, sky: Sky) -> None:
        """Sum up the light of all directions."""
        self._sky = sky
        self._clear: NDArray[np.float32] | None = None
        if sky.hdri is None and sky.model == "atmosphere":
            found = atmosphere.clear_sky(
                sky.sun_elevation_rad, sky.altitude_m, sky.air, sky.dust, sky.ozone
            )
            self._clear = found * np.float32(sky.sky_strength)
        rays = _directions()
        factors = np.array(daylight_factors(sky), np.float32)
        radiance = self._behind_haze(rays, self._without_haze(rays) * factors)
        radiance[rays[:, 2] < 0] = 0
        # Each direction stands for the same solid angle.
        basis = _harmonics(rays.astype(np.float32))
        coefficients = basis.T @ radiance * np.float32(4 * pi / len(rays))
        bands = np.array([COSINE_LOBE[band] for band in (0, 1, 1, 1, 2, 2, 2, 2, 2)], np.float32)
        self._irradiance = (coefficients * bands[:, None]).astype(np.float32)
        self._match_level_ground(rays, radiance)

    def _match_level_ground(self, rays: FloatArray, radiance: Floats) -> None:
        """Scale the irradiance so that it is exact on level ground.

        Three bands miss a percent of a sky that is brighter towards the horizon.
        """
        exact = np.maximum(rays[:, 2], 0) @ radiance.astype(np.float64) * (4 * pi / len(rays))
        found = self.irradiance(np.array([(0, 0, 1)], np.float32))[0]
        self._irradiance *= np.where(found > 0, exact / np.maximum(found, 1e-12), 1)

    def irradiance(self, normals: Floats) -> Floats:
        """Return (N, 3) irradiance of surfaces with (N, 3) unit normals and a free view."""
        basis = _harmonics(normals).T
        found = zeros(len(normals), 3)
        for channel, coefficients in zip(found.T, self._irradiance.T, strict=True):
            # A product of matrices would wake threads of its own in each of ours.
            for values, coefficient in zip(basis, coefficients.tolist(), strict=True):
                cv2.scaleAdd(values, coefficient, channel, dst=channel)
        return np.maximum(found, 0, out=found)

    def radiance(self, rays: FloatArray, *, with_disc: bool = False) -> Floats:
        """Return the (N, 3) radiance of the sky along (N, 3) rays of any length, behind haze.

        With the sun's disc, if it is to be seen.
        """
        sky, found = self._sky, self._without_haze(rays)
        is_seen = sky.shows_clouds & (rays[:, 2] >= 0)
        if sky.shows_clouds:
            found[is_seen] = before_sky(sky, rays[is_seen], found[is_seen])
        if with_disc and sky.sun_disc > 0:
            radius_rad = max(sky.sun_angular_diameter_rad / 2, MIN_DISC_RAD)
            cosines = rays @ np.array(sky.to_sun) / np.linalg.norm(rays, axis=1)
            brightness = sky.sun_disc * sky.sun_strength_w_m2 / (pi * sin(radius_rad) ** 2)
            disc = brightness * np.array(sun_color(sky))
            is_disc = cosines > cos(radius_rad)
            if sky.shows_clouds and is_disc.any():
                disc = disc * sun_through_clouds(sky, rays[is_disc])[:, None]
            found[is_disc] += disc.astype(np.float32)
        return self._behind_haze(rays, found)

    def _behind_haze(self, rays: FloatArray, found: Floats) -> Floats:
        haze = self._sky.haze
        if haze is None:
            return found
        up = rays[:, 2] / np.linalg.norm(rays, axis=1)
        away_m = haze.thickness_m / np.maximum(up, MIN_UP)
        return np.asarray(in_haze(found.astype(np.float64), away_m, haze, self._sky), np.float32)

    def _without_haze(self, rays: FloatArray) -> Floats:
        sky = self._sky
        if sky.hdri is not None:
            pixels = sky.hdri.image.radiance
            rows, columns = texels_at(rays, sky.hdri.rotation_rad, pixels.shape)
            return np.asarray(pixels[rows, columns] * sky.hdri.strength, np.float32)
        if sky.model == "none":
            return np.zeros(rays.shape, np.float32)
        unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        if self._clear is None:
            found = np.asarray(
                gradient_radiance(sky.gradient, unit, np.array(sky.to_sun)) * sky.sky_strength,
                np.float32,
            )
        else:
            found = self._clear_radiance(self._clear, unit)
        below = unit[:, 2] < 0
        if sky.shows_plain and not sky.dips:
            found[below] = plain_radiance(sky)
        elif self._clear is not None and not sky.shows_plain:
            # As Blender's: the ground far below is black.
            found[below] *= np.maximum(1 + FADE_BELOW * unit[below, 2:], 0).astype(np.float32) ** 3
        return found

    def _clear_radiance(self, clear: NDArray[np.float32], unit: FloatArray) -> Floats:
        sky = self._sky
        up_rad = np.arcsin(np.clip(unit[:, 2], 0, 1))
        rows = np.sqrt(up_rad * (2 / pi)) * (atmosphere.ROWS - 1)
        apart = np.arctan2(unit[:, 1], unit[:, 0]) - sky.sun_azimuth_rad
        apart = np.abs((apart + pi) % (2 * pi) - pi)
        columns = apart * ((atmosphere.COLUMNS - 1) / pi)
        return sample(clear, columns.astype(np.float32), rows.astype(np.float32))


def _directions() -> FloatArray:
    """Return unit vectors that are spread evenly over all directions."""
    up = (np.arange(RINGS) + 0.5) / RINGS * 2 - 1
    azimuth = (np.arange(SECTORS) + 0.5) * (2 * pi / SECTORS)
    level = np.sqrt(1 - up * up)[:, None]
    rays = np.empty((RINGS, SECTORS, 3))
    rays[..., 0], rays[..., 1] = level * np.cos(azimuth), level * np.sin(azimuth)
    rays[..., 2] = up[:, None]
    return rays.reshape(-1, 3)


def _harmonics(directions: Floats) -> Floats:
    """Return (N, 9) real spherical harmonics of (N, 3) unit vectors."""
    x, y, z = directions.T
    found = empty(len(directions), 9)
    found[:, 0] = 0.282095
    found[:, 1], found[:, 2], found[:, 3] = 0.488603 * y, 0.488603 * z, 0.488603 * x
    found[:, 4], found[:, 5] = 1.092548 * x * y, 1.092548 * y * z
    found[:, 6] = 0.315392 * (3 * z * z - 1)
    found[:, 7], found[:, 8] = 1.092548 * x * z, 0.546274 * (x * x - y * y)
    return found
