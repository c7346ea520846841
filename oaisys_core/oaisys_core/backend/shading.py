"""Simple colour for rays that were cast: mean colours under Lambert's law, and a graded sky."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.surface import View
from oaisys_core.color import encoded, linear
from oaisys_core.scene import PbrMaps, Scene, Sky
from oaisys_core.types import FloatArray

__all__ = ["Palette", "encoded", "linear", "mean_color", "shaded", "sky_color"]

SKY_IRRADIANCE_W_M2 = 1.0
"""Irradiance of the whole sky on level ground, at a sky strength of 1."""

HORIZON_COLOR = np.array([0.55, 0.65, 0.75])
ZENITH_COLOR = np.array([0.14, 0.28, 0.60])
"""Linear colours that the sky's gradient runs between."""


class Palette:
    """Linear colours of everything in a scene."""

    def __init__(self, scene: Scene) -> None:
        self._material = scene.material
        self._layers = np.array([mean_color(layer.maps) for layer in scene.material.layers])
        ids = [p.instance_ids for p in scene.placements]
        ids.append(np.array([p.instance_id for p in scene.primitives], dtype=np.uint32))
        colors = [np.empty((0, 3))]
        for placement in scene.placements:
            prototype = scene.prototypes[placement.prototype]
            color = mean_color(prototype.maps) if prototype.maps else linear(prototype.color_srgb)
            colors.append(np.tile(color, (len(placement.instance_ids), 1)))
        colors.extend(linear(p.color_srgb)[None] for p in scene.primitives)
        order = np.argsort(np.concatenate(ids))
        self._instance_ids = np.concatenate(ids)[order]
        self._instance_colors = np.concatenate(colors)[order]

    def albedo(self, view: View) -> FloatArray:
        """Return the (H, W, 3) linear reflectance of what a view sees, 0 for nothing."""
        albedo = np.zeros_like(view.points_m)
        ground_xy_m = view.points_m[view.is_ground][:, :2]
        albedo[view.is_ground] = self._material.weights_at(ground_xy_m) @ self._layers
        on_object = view.instance_ids > 0
        rows = np.searchsorted(self._instance_ids, view.instance_ids[on_object])
        albedo[on_object] = self._instance_colors[rows]
        return albedo


def shaded(
    view: View, normals: FloatArray, palette: Palette, sky: Sky, exposure_ev: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) sRGB colour of a view.

    Radiance is albedo / π times the irradiance of sun and sky; the sky's share falls to half on
    a wall (a uniform hemisphere above level ground). White is a radiance of 1 at 0 EV.
    """
    elevation, azimuth = sky.sun_elevation_rad, sky.sun_azimuth_rad
    to_sun = np.array(
        [cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation)]
    )
    sun_w_m2 = sky.sun_strength_w_m2 * np.maximum(normals @ to_sun, 0.0) * (elevation > 0)
    sky_w_m2 = SKY_IRRADIANCE_W_M2 * sky.sky_strength * (1 + normals[..., 2]) / 2
    radiance = palette.albedo(view) * ((sun_w_m2 + sky_w_m2) / pi)[..., None]
    seen = view.is_hit
    radiance[~seen] = sky.sky_strength * sky_color(view.directions[~seen])
    return encoded(radiance * 2.0**exposure_ev)


def sky_color(directions: FloatArray) -> FloatArray:
    """Return the (N, 3) linear colour of the sky along (N, 3) directions in ``map``."""
    up = directions[:, 2] / np.linalg.norm(directions, axis=1)
    share = np.sqrt(np.maximum(up, 0.0))[:, None]
    return np.asarray(HORIZON_COLOR * (1 - share) + ZENITH_COLOR * share)


def mean_color(maps: PbrMaps) -> FloatArray:
    """Return the (3,) mean linear colour of a texture."""
    levels = linear(np.arange(256) / 255)
    return np.array(
        [
            np.bincount(maps.color_srgb[..., channel].ravel(), minlength=256) @ levels
            for channel in range(3)
        ]
    ) / (maps.color_srgb.size / 3)
