"""Simple colour for cast rays: mean albedo under Lambert's law, and a sky with a gradient."""

from __future__ import annotations

from math import pi

import numpy as np

from oaisys_core.color import LUMINANCE, linear, mean_linear
from oaisys_core.procedural.environment.clouds.daylight import daylight_factors
from oaisys_core.procedural.environment.clouds.dome import before_sky
from oaisys_core.procedural.environment.light import (
    gradient_irradiance_w_m2,
    sky_irradiance_w_m2,
    veil_radiance,
)
from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import InstanceTable, View
from oaisys_core.render.shading.lamp_light import lamp_irradiance_w_m2
from oaisys_core.render.shading.photometry import law_factors
from oaisys_core.scene import MeshMaterial, MeshPrototype, PbrMaps, Scene
from oaisys_core.scene.sky import Haze, Sky, gradient_radiance, texels_at
from oaisys_core.types import FloatArray

MIN_UP = 1e-4
"""Least upward component of a ray, which bounds its way through the haze layer."""


class Palette:
    """Linear mean colours of a scene's ground layers and objects."""

    def __init__(self, scene: Scene) -> None:
        self._means: dict[int, tuple[object, FloatArray]] = {}
        self.update(scene)

    def update(self, scene: Scene) -> None:
        """Take over a changed scene; means of textures that were seen before are reused."""
        self._material = scene.material
        self._layers = np.array([self._mean_of(layer.maps) for layer in scene.material.layers])
        of_placements = [self._mean_of(scene.prototypes[p.prototype]) for p in scene.placements]
        of_primitives = [linear(p.color_srgb) for p in scene.primitives]
        self._of_instance = InstanceTable(scene, of_placements, of_primitives, np.float64)

    def albedo(self, view: View, surface: Surface) -> FloatArray:
        """Return the (H, W, 3) linear albedo of a view, 0 where nothing was hit."""
        albedo = np.zeros_like(view.points_m)
        ground_xy_m = view.points_m[view.is_ground][:, :2]
        of_ground = self._material.weights_at(ground_xy_m) @ self._layers
        if self._material.macro is not None:
            of_ground *= self._material.macro.factors_at(ground_xy_m)
        albedo[view.is_ground] = of_ground
        on_object = view.instance_ids > 0
        if on_object.any():
            albedo[on_object] = self.albedo_of_objects(view, surface)[on_object]
        return albedo

    def albedo_of_objects(self, view: View, surface: Surface) -> FloatArray:
        """Return the (H, W, 3) linear albedo of objects in a view, 0 elsewhere.

        It is that of their images, if they have any, else their mean colour.
        """
        mean, own = self._of_instance(view.instance_ids), surface.own_albedo(view)
        return mean if own is None else np.where(np.isnan(own), mean, own)

    def _mean_of(self, thing: PbrMaps | MeshPrototype) -> FloatArray:
        if isinstance(thing, MeshPrototype) and thing.maps is not None:
            # Dozens of prototypes have the same texture.
            return self._mean_of(thing.maps)
        if id(thing) not in self._means:
            color = mean_color(thing) if isinstance(thing, PbrMaps) else prototype_color(thing)
            self._means[id(thing)] = (thing, color)
        return self._means[id(thing)][1]


def shade(view: View, palette: Palette, surface: Surface) -> FloatArray:
    """Return the (H, W, 3) radiance of a view; 1 is white at 0 EV.

    It is albedo / π times the irradiance of sun, sky and lamps. The sky is a uniform hemisphere, of
    which a vertical wall receives half. Ground with a photometric law has its factors for sun and
    sky; lamps are as by Lambert's law.
    """
    scene, normals = surface.scene, surface.normals(view)
    sky = scene.sky
    sun_w_m2 = sky.lamp_w_m2 * np.maximum(normals @ np.array(sky.to_sun), 0.0)
    of_sky_w_m2 = sky_irradiance_w_m2(sky) * daylight_factors(sky)
    sky_w_m2 = of_sky_w_m2 @ LUMINANCE * (1 + normals[..., 2]) / 2
    albedo, seen = palette.albedo(view, surface), view.is_hit
    if scene.material.law is not None:
        on_ground = view.is_ground
        of_sun, of_sky = law_factors(
            scene.material.law, normals[on_ground], view.directions[on_ground], sky.to_sun
        )
        sun_w_m2[on_ground] *= of_sun
        sky_w_m2[on_ground] *= of_sky
    radiance = albedo * ((sun_w_m2 + sky_w_m2) / pi)[..., None]
    if scene.lamps:
        lamps_w_m2 = lamp_irradiance_w_m2(scene.lamps, view.points_m[seen], normals[seen])
        radiance[seen] += albedo[seen] * lamps_w_m2 / pi
    if sky.haze is not None:
        distance_m = view.depth_m[seen] * np.linalg.norm(view.directions[seen], axis=-1)
        radiance[seen] = in_haze(radiance[seen], distance_m, sky.haze, sky)
    radiance[~seen] = sky_radiance(sky, view.directions[~seen])
    return np.asarray(radiance)


def prototype_color(prototype: MeshPrototype) -> FloatArray:
    """Return the (3,) mean linear colour of a prototype without a texture set."""
    if prototype.image_materials:
        colors = [_material_color(each) for each in prototype.image_materials]
        return np.asarray(np.mean(colors, axis=0))
    if prototype.vertex_colors_srgb is not None:
        return mean_linear(prototype.vertex_colors_srgb)
    return linear(prototype.color_srgb)


def _material_color(material: MeshMaterial) -> FloatArray:
    if material.color_image_srgb is None:
        return linear(material.color_srgb)
    return mean_linear(material.color_image_srgb)


def mean_color(maps: PbrMaps) -> FloatArray:
    """Return the (3,) mean linear colour of a texture."""
    return mean_linear(maps.color_srgb)


def sky_radiance(sky: Sky, directions: FloatArray) -> FloatArray:
    """Return the (N, 3) linear radiance of the sky along (N, 3) directions in ``map``."""
    radiance = _clear_radiance(sky, directions)
    if sky.shows_clouds:
        is_up = directions[:, 2] >= 0
        radiance[is_up] = before_sky(sky, directions[is_up], radiance[is_up])
    if sky.haze is None:
        return radiance
    up = directions[:, 2] / np.linalg.norm(directions, axis=1)
    distance_m = sky.haze.thickness_m / np.maximum(up, MIN_UP)
    return in_haze(radiance, distance_m, sky.haze, sky)


def _clear_radiance(sky: Sky, directions: FloatArray) -> FloatArray:
    if sky.hdri is not None:
        pixels = sky.hdri.image.radiance
        rows, cols = texels_at(directions, sky.hdri.rotation_rad, pixels.shape)
        return np.asarray(pixels[rows, cols] * sky.hdri.strength, dtype=np.float64)
    if sky.model == "none":
        return np.zeros_like(directions)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    radiance = gradient_radiance(sky.gradient, unit, np.array(sky.to_sun))
    if sky.model == "plain":
        return radiance * sky.sky_strength
    # The default colours, as bright as the atmosphere.
    shown_w_m2 = np.array(gradient_irradiance_w_m2(sky.gradient, sky.sun_elevation_rad))
    brightness = (sky_irradiance_w_m2(sky) @ LUMINANCE) / (shown_w_m2 @ LUMINANCE)
    return np.asarray(radiance * brightness)


def in_haze(radiance: FloatArray, distance_m: FloatArray, haze: Haze, sky: Sky) -> FloatArray:
    """Return (N, 3) radiances seen through haze at (N,) distances (Koschmieder's law)."""
    airlight = np.array(veil_radiance(sky, haze))
    clear = np.exp(-distance_m[:, None] * np.array(haze.extinction_per_m))
    return np.asarray(radiance * clear + airlight * (1 - clear))
