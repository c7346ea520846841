"""The check of photometric laws: patches under a sun, seen from several sides."""

from __future__ import annotations

from collections.abc import Iterator
from math import acos, cos, pi, radians, sin

import numpy as np

from oaisys_core.scene.photometric_laws import Hapke, LommelSeeliger, LunarLambert, PhotometricLaw
from oaisys_core.types import FloatArray
from oaisys_core.verification.light.light_figure import LightFigure
from oaisys_core.verification.light.photometric_forms import radiance_factor
from oaisys_core.verification.light.renderer import Renderer
from oaisys_core.verification.light.scenes import GreyPlane, camera, rays_of, sunny, world

SUN = 4.0
POINT_SUN_RAD = 1e-4
"""Diameter of a sun that does not blur the opposition surge."""

LAWS: dict[str, PhotometricLaw] = {
    "Lommel-Seeliger": LommelSeeliger(),
    "Lunar-Lambert": LunarLambert(),
    "Hapke": Hapke(0.32, 0.24, 0.30, 1.8, 0.071, radians(23.4)),
}

GEOMETRIES = (
    # Slope of the ground, elevation of the sun, azimuth and elevation of the eye.
    (0.0, 40.0, 0.0, 40.0),
    (0.0, 40.0, 3.0, 38.0),
    (0.0, 60.0, 0.0, 90.0),
    (0.0, 20.0, 180.0, 30.0),
    (25.0, 50.0, 100.0, 55.0),
    (-25.0, 15.0, 45.0, 40.0),
)
"""In degrees; the sun's azimuth is 0, towards which the ground rises."""


def photometric_laws(renderer: Renderer) -> Iterator[LightFigure]:
    """Flat and sloped patches of each law, at the opposition, near to it and elsewhere."""
    for name, law in LAWS.items():
        for slope_deg, sun_deg, azimuth_deg, eye_deg in GEOMETRIES:
            ground = GreyPlane(slope_rad=radians(slope_deg), law=law)
            to_eye = _direction(radians(azimuth_deg), radians(eye_deg))
            eye_m = 6.0 * to_eye
            view = camera(tuple(eye_m.round(12).tolist()), (0.0, 0.0, 0.0), (8, 6), 2000.0)
            sky = sunny(radians(sun_deg), POINT_SUN_RAD)
            image = renderer.image(world(ground, sky), view, 16)
            rays = rays_of(view).reshape(-1, 3)
            expected = _expected(ground, law, radians(sun_deg), rays)
            where = (
                f"slope {slope_deg:g}°, sun at {sun_deg:g}°, eye at {azimuth_deg:g}°/{eye_deg:g}°"
            )
            yield LightFigure(f"{name}, {where}", float(image.mean()), expected)


def _direction(azimuth_rad: float, elevation_rad: float) -> FloatArray:
    level = cos(elevation_rad)
    return np.array((level * cos(azimuth_rad), level * sin(azimuth_rad), sin(elevation_rad)))


def _expected(ground: GreyPlane, law: PhotometricLaw, sun_rad: float, rays: FloatArray) -> float:
    """Return the mean radiance along (N, 3) rays."""
    normal = np.array((-sin(ground.slope_rad), 0.0, cos(ground.slope_rad)))
    to_sun = _direction(0.0, sun_rad)
    found = []
    for ray in rays:
        to_eye = -ray / np.linalg.norm(ray)
        i, e, g = (_angle(*pair) for pair in ((normal, to_sun), (normal, to_eye), (to_sun, to_eye)))
        found.append(radiance_factor(ground.albedo, law, i, e, g) * SUN / pi)
    return float(np.mean(found))


def _angle(first: FloatArray, second: FloatArray) -> float:
    return acos(max(-1.0, min(1.0, float(first @ second))))
