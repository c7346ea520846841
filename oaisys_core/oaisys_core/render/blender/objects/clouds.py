"""Shader nodes of cumulus clouds before the sky.

They are a heap of thin layers at rising heights: each shows the places where noise exceeds a
threshold that rises with the height, so that clouds have flat, dark undersides and bright tops.
"""

from __future__ import annotations

from math import pi, sin
from statistics import NormalDist

import numpy as np

from oaisys_core.procedural.environment.light import sky_irradiance_w_m2, sun_color
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.scene.sky import Clouds, Color, Sky

EARTH_KM = 6371.0
"""Radius of the body: a layer of clouds curves down to the horizon."""

LAYERS = 7
"""Thin layers that clouds consist of."""

MAX_RISE = 0.24
"""Height of the topmost layer above the base, in sizes."""

OCTAVES, FINE_OCTAVES, ROUGHNESS = 2, 4, 0.55
"""Octaves of noise that each layer has of its own, finer ones that all of them share, and the
amplitude of each octave relative to the one before."""

NOISE_MEAN, NOISE_DEVIATION = 0.5, 0.088
"""Of Blender's noise with these octaves."""

COARSE_SHARE = (1 - ROUGHNESS**OCTAVES) / (1 - ROUGHNESS ** (OCTAVES + FINE_OCTAVES))
"""Share of the first octaves in the noise."""

RISE_OF_NOISE = 0.13
"""By how much noise must exceed the threshold of the base to reach the topmost layer."""

EDGE = 0.055
"""Excess of the noise within which a layer's edge becomes opaque."""

ALBEDO, DARKEST = 0.6, 0.3
"""Light that sunlit tops return, and that of the undersides relative to it."""

VISIBILITY_KM = 22.0
"""Distance over which air replaces 1 - 1 / e of a cloud's light by the sky's."""

SILVER, SILVER_RAD = 0.9, 0.3
"""Light that thin clouds scatter forwards, relative to the rest, and its angle from the sun."""


def before_sky(tree: NodeTree, sky: Sky, clouds: Clouds, ray: Socket, color: Socket) -> Socket:
    """Return the colour of clouds before a sky of ``color``, along unit vectors ``ray``."""
    x, y, up = tree.add("SeparateXYZ", {0: ray}).outputs
    up = tree.math("MAXIMUM", up, 0.0)
    level = tree.combine(x, y, 0.0)
    threshold = NOISE_MEAN + NOISE_DEVIATION * NormalDist().inv_cdf(
        min(max(1 - clouds.cover, 1e-6), 1 - 1e-6)
    )
    lit = np.array(_radiance_of_top(sky))
    bright = _towards_sun_gain(tree, sky, ray)
    middle_km = (clouds.base_m + MAX_RISE / 2 * clouds.size_m) / 1000
    fine = _noise(
        tree, _place(tree, clouds, level, _distance_km(tree, up, middle_km)), is_fine=True
    )
    # From the topmost, which is farthest, to the base.
    for layer in range(LAYERS - 1, -1, -1):
        rise = layer / (LAYERS - 1)
        height_km = (clouds.base_m + MAX_RISE * rise * clouds.size_m) / 1000
        away_km = _distance_km(tree, up, height_km)
        coarse = _noise(tree, _place(tree, clouds, level, away_km), is_fine=False)
        noise = tree.math("MULTIPLY_ADD", coarse, COARSE_SHARE, fine)
        excess = tree.math("SUBTRACT", noise, threshold + RISE_OF_NOISE * rise**1.5 - EDGE / 2)
        opaque = tree.clamp("DIVIDE", excess, EDGE)
        clear = tree.math("EXPONENT", tree.math("DIVIDE", away_km, -VISIBILITY_KM))
        share = tree.math("MULTIPLY", tree.math("SMOOTH_MIN", opaque, 1.0, 0.2), clear)
        # Thick clouds let less light down to their undersides.
        thick = tree.clamp("DIVIDE", excess, RISE_OF_NOISE)
        shade = tree.math("MULTIPLY_ADD", thick, -(1 - DARKEST) * (1 - rise), 1.0)
        radiance = tree.scale(tuple(lit.tolist()), tree.math("MULTIPLY", shade, bright))
        change = tree.vector("SUBTRACT", radiance, color)
        color = tree.vector("ADD", color, tree.scale(change, share))
    return color


def _place(tree: NodeTree, clouds: Clouds, level: Socket, away_km: Socket) -> Socket:
    """Return the place in the pattern at a distance along the level part of a ray."""
    sizes = tree.math("DIVIDE", away_km, clouds.size_m / 1000)
    return tree.vector("ADD", tree.scale(level, sizes), (*clouds.start, 0.0))


def _noise(tree: NodeTree, place: Socket, *, is_fine: bool) -> Socket:
    """Return the coarse octaves of the noise, 0 to 1, or the share that the fine ones add."""
    inputs: dict[str | int, float | Socket] = {
        "Vector": place,
        "Scale": 2.0**OCTAVES if is_fine else 1.0,
        # Octaves after the first.
        "Detail": float(FINE_OCTAVES if is_fine else OCTAVES) - 1,
        "Roughness": ROUGHNESS,
    }
    noise = tree.add("TexNoise", inputs, noise_dimensions="2D").outputs[0]
    return tree.math("MULTIPLY", noise, 1 - COARSE_SHARE) if is_fine else noise


def _distance_km(tree: NodeTree, up: Socket, height_km: float) -> Socket:
    """Return the distance to a shell at a height, in a direction whose vertical part is ``up``."""
    rise_km = tree.math("MULTIPLY", up, EARTH_KM)
    square = tree.math("MULTIPLY_ADD", rise_km, rise_km, (2 * EARTH_KM + height_km) * height_km)
    return tree.math("SUBTRACT", tree.math("SQRT", square), rise_km)


def _radiance_of_top(sky: Sky) -> Color:
    """Return the radiance of a sunlit top."""
    # A cloud's sides catch a low sun.
    facing = 0.25 + 0.75 * max(sin(sky.sun_elevation_rad), 0.0)
    irradiance_w_m2 = sky.lamp_w_m2 * facing * np.array(sun_color(sky)) + sky_irradiance_w_m2(sky)
    red, green, blue = (ALBEDO / pi * irradiance_w_m2).tolist()
    return (red, green, blue)


def _towards_sun_gain(tree: NodeTree, sky: Sky, ray: Socket) -> Socket:
    """Return a factor above 1 near the sun."""
    product = tree.add("VectorMath", {0: ray, 1: sky.to_sun}, operation="DOT_PRODUCT")
    angle = tree.math("ARCCOSINE", tree.math("MINIMUM", product.outputs["Value"], 1.0))
    near = tree.math("EXPONENT", tree.math("DIVIDE", angle, -SILVER_RAD))
    return tree.math("MULTIPLY_ADD", near, SILVER, 1.0)
