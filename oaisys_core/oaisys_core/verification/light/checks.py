"""The checks of the audit of light: each renders small pictures and compares them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import atan2, degrees, pi, radians, sin, tan

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.sensing.image_sensor import ImageSensorConfig
from oaisys_core.geometry import transform
from oaisys_core.render.base import Backend
from oaisys_core.scene import Lamp, Primitive
from oaisys_core.sensing.digitizing import digitize, electrons_per_s
from oaisys_core.types import MONO16, FloatArray
from oaisys_core.verification.light import closed_forms
from oaisys_core.verification.light.law_checks import photometric_laws
from oaisys_core.verification.light.light_figure import LightFigure
from oaisys_core.verification.light.renderer import Renderer
from oaisys_core.verification.light.scenes import (
    GreyPlane,
    camera,
    dark,
    grey_sky,
    points_seen_m,
    sunny,
    world,
)

SUN = 4.0
DOWN = camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0))
NARROW = camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), (8, 6), 200.0)
"""Sees its patch within two degrees of the vertical."""

LAMP_W = 1000.0
EDGE_M, SUN_DIAMETER_DEG, SUN_ELEVATION_DEG = 3.0, 3.0, 45.0
"""Height of the edge whose shadow is measured, and the sun that casts it."""


Check = Callable[[Renderer], Iterator[LightFigure]]


def figures(backend: Backend, quality: str, on_check: Callable[[], None]) -> list[LightFigure]:
    """Return the figures of all checks.

    Args:
        backend: Renders; it keeps the last of the audit's worlds.
        quality: ``draft``, or a name for what Cycles renders.
        on_check: Called after each check.
    """
    found: list[LightFigure] = []
    renderer = Renderer(backend, quality)
    for check in CHECKS:
        found.extend(check(renderer))
        on_check()
    return found


def _lambert(renderer: Renderer) -> Iterator[LightFigure]:
    """Flat and sloped patches under a sun: irradiance goes by the cosine of its angle."""
    for slope_deg, elevation_deg in ((0, 90), (0, 30), (0, 8), (25, 40), (-25, 40)):
        ground = GreyPlane(slope_rad=radians(slope_deg))
        image = renderer.image(world(ground, sunny(radians(elevation_deg))), DOWN, 16)
        # The sun is over +x, towards which the ground rises: it stands lower over a slope.
        cosine = sin(radians(elevation_deg - slope_deg))
        expected = closed_forms.lambert(ground.albedo, SUN * cosine)
        name = f"Lambert, slope {slope_deg}°, sun at {elevation_deg}°"
        yield LightFigure(name, float(image.mean()), expected)


def _rough(renderer: Renderer) -> Iterator[LightFigure]:
    """Rough ground, seen from above."""
    ground = GreyPlane(roughness=230, is_lambertian=False)
    for elevation_deg in (75, 25):
        image = renderer.image(world(ground, sunny(radians(elevation_deg))), NARROW, 256)
        cosine = sin(radians(elevation_deg))
        factor = closed_forms.rough_from_above(ground.albedo, 230 / 255, cosine)
        expected = factor * closed_forms.lambert(ground.albedo, SUN * cosine)
        name = f"rough ground (0.9), sun at {elevation_deg}°"
        yield LightFigure(name, float(image.mean()), expected)


def _sky(renderer: Renderer) -> Iterator[LightFigure]:
    """A white furnace, and a sky that is brighter towards the horizon."""
    white = GreyPlane(grey=255)
    image = renderer.image(world(white, grey_sky(1.0, 1.0)), DOWN, 256)
    yield LightFigure("white furnace", float(image.mean()), 1.0)
    for name, zenith, horizon, power in (
        ("a sky of 0.3 (zenith) to 1.0 (horizon)", 0.3, 1.0, 0.5),
        ("a sky of 1.0 (zenith) to 0.2 (horizon)", 1.0, 0.2, 0.5),
        ("the CIE's overcast sky", 1.0, 1 / 3, 1.0),
    ):
        image = renderer.image(world(white, grey_sky(zenith, horizon, power)), DOWN, 256)
        expected = closed_forms.gradient_irradiance(zenith, horizon, power)
        yield LightFigure(f"irradiance of {name}", pi * float(image.mean()), expected)


def _lamp(kind: str, height_m: float) -> Lamp:
    return Lamp(
        name="lamp",
        kind="spot" if kind == "spot" else "point",
        frame="map",
        position_m=(0.0, 0.0, height_m),
        forward=(0.0, 0.0, -1.0),
        right=(1.0, 0.0, 0.0),
        strength_w=LAMP_W,
        color=(1.0, 1.0, 1.0),
        radius_m=0.01,
        cone_rad=radians(40.0),
    )


def _inverse_square(renderer: Renderer) -> Iterator[LightFigure]:
    """A point lamp over level ground, at several heights."""
    ground = GreyPlane()
    for height_m in (2.0, 4.0, 8.0):
        scene = world(ground, dark(), (_lamp("point", height_m),))
        image = renderer.image(scene, NARROW, 64)
        distance_m = np.hypot(np.linalg.norm(points_seen_m(NARROW)[..., :2], axis=-1), height_m)
        irradiance = LAMP_W / (4 * pi * distance_m**2) * height_m / distance_m
        expected = closed_forms.lambert(ground.albedo, float(irradiance.mean()))
        yield LightFigure(f"point lamp {height_m:g} m above", float(image.mean()), expected)


def _cone(renderer: Renderer) -> Iterator[LightFigure]:
    """The circle that a spot lights, by its area."""
    height_m = 4.0
    scene = world(GreyPlane(), dark(), (_lamp("spot", height_m),))
    view = camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), (64, 64), 96.0)
    image = renderer.image(scene, view, 16)
    points_m = points_seen_m(view)
    distance_m = np.hypot(np.linalg.norm(points_m[..., :2], axis=-1), height_m)
    # Relative to a lamp without a cone, a pixel at the edge has the share that lies within.
    full = GreyPlane().albedo / pi * LAMP_W / (4 * pi * distance_m**2) * height_m / distance_m
    lit = np.clip(image / full, 0.0, 1.0).sum()
    area_m2 = lit * (6.0 / 96.0) ** 2
    angle_deg = 2 * degrees(atan2(np.sqrt(area_m2 / pi), height_m))
    yield LightFigure("cone of a spot, degrees", float(angle_deg), 40.0)


def _penumbra(renderer: Renderer) -> Iterator[LightFigure]:
    """The shadow of a level edge: how wide it is from 10 to 90 % of the sun's light."""
    radius_rad, elevation_rad = radians(SUN_DIAMETER_DEG / 2), radians(SUN_ELEVATION_DEG)
    box = Primitive(
        "box", (2.0, 30.0, 2 * EDGE_M), transform(np.eye(3), (1.0, 0.0, 0.0)), 1, (1,), (0.0,) * 3
    )
    # The box stands from x = 0 to 2 and is EDGE_M high; the sun is over +x, its shadow at x < 0.
    sky = sunny(elevation_rad, 2 * radius_rad)
    middle_m = -EDGE_M / tan(elevation_rad)
    view = camera((middle_m - 3.0, 0.0, 5.0), (middle_m, 0.0, 0.0), (64, 48), 420.0)
    image = renderer.image(world(GreyPlane(), sky, primitives=(box,)), view, 256)
    x_m = points_seen_m(view)[..., 0].ravel()
    full = closed_forms.lambert(GreyPlane().albedo, SUN * sin(elevation_rad))
    measured = _width_m(x_m, image.ravel() / full)
    exact_x_m = np.linspace(x_m.min(), x_m.max(), 4000)
    above = elevation_rad - np.arctan2(EDGE_M, -exact_x_m)
    exact = closed_forms.visible_share_of_disc(above / radius_rad)
    expected = _width_m(exact_x_m, exact)
    yield LightFigure("penumbra, 10 to 90 %, m", measured, expected, 0.03)


def _width_m(x_m: FloatArray, shares: FloatArray) -> float:
    """Return the distance between the places of 10 and 90 % of light; x grows into the shadow."""
    order = np.argsort(x_m)
    bins = np.array_split(order, min(120, len(order)))
    places = np.array([x_m[each].mean() for each in bins])
    light = np.array([shares[each].mean() for each in bins])
    low, high = (float(np.interp(-level, -light, places)) for level in (0.1, 0.9))
    return low - high


def _sensor(_: Renderer) -> Iterator[LightFigure]:
    """Linearity, gain and noise of digital numbers by the photon transfer method (EMVA 1288)."""
    sensor = ImageSensorConfig(
        exposure_time_s=0.001, prnu=0.0, dsnu_e=0.0, bits=16, full_well_e=20_000.0
    ).image_sensor
    levels = np.linspace(0.0, 3.0, 9)

    def numbers(level: float, time_s: float, seed: int) -> NDArray[np.float64]:
        rate = electrons_per_s(np.full((200, 200, 3), level, np.float32), sensor)
        return digitize(rate, MONO16, sensor, time_s, seed, "audit").astype(np.float64)

    pairs = [(numbers(each, 0.001, 1), numbers(each, 0.001, 2)) for each in levels]
    means = np.array([(a + b).mean() / 2 for a, b in pairs])
    variances = np.array([(a - b).var() / 2 for a, b in pairs])
    gain = float(np.polyfit(means - means[0], variances, 1)[0])
    yield LightFigure("gain by photon transfer, DN/e-", gain, sensor.gain, 0.02)
    dark_e2 = sensor.read_noise_e**2 + sensor.dark_current_e_s * 0.001
    # Rounding adds the variance of a uniform number.
    dark_dn = np.sqrt(sensor.gain**2 * dark_e2 + 1 / 12)
    yield LightFigure("dark noise, DN", float(np.sqrt(variances[0])), float(dark_dn), 0.02)
    short, long = (numbers(1.0, time_s, 3).mean() for time_s in (0.0005, 0.002))
    ratio = (long - sensor.black_level_dn) / (short - sensor.black_level_dn)
    yield LightFigure("four times the exposure time", float(ratio), 4.0)


CHECKS: Sequence[Check] = (
    _lambert,
    _rough,
    photometric_laws,
    _sky,
    _inverse_square,
    _cone,
    _penumbra,
    _sensor,
)
