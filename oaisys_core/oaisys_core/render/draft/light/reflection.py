"""What surfaces reflect of the sun, the sky and the ground nearby."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from oaisys_core.procedural.environment.light import sun_color
from oaisys_core.render.draft.appearance import Appearance, Floats, dot, put, take
from oaisys_core.render.draft.light.diffuse import RoughDiffuse, bent_share
from oaisys_core.render.draft.light.ground_nearby import Flags, ground_share
from oaisys_core.render.draft.light.sky_light import SkyLight
from oaisys_core.render.shading.looks import THROUGH_LEAF
from oaisys_core.render.shading.photometry import law_factors
from oaisys_core.scene.photometric_laws import PhotometricLaw
from oaisys_core.scene.sky import Sky

HIDDEN_LIGHT = 0.5
"""Radiance of what hides the sky, relative to that of the ground nearby: its side is often dark."""

FREE_OF_LEAVES = 0.75
"""Share of the sky that leaves leave to each other."""

INVERSE_PI = np.float32(1 / pi)


class Nearby(NamedTuple):
    """The light at N points.

    Attributes:
        to_eye: (N, 3) unit vectors.
        sun_share: (N,) of the sun's disc that they see.
        free: (N,) share of the sky that they see.
        ground: (N, 3) radiance of the ground nearby.
        is_ground: (N,) whether they are ground themselves.
    """

    to_eye: Floats
    sun_share: Floats
    free: Floats
    ground: Floats
    is_ground: Flags


def sun_w_m2(sky: Sky) -> Floats:
    """Return the (3,) irradiance of a surface across the sun's rays."""
    return (sky.lamp_w_m2 * np.array(sun_color(sky))).astype(np.float32)


def reflect(
    light: SkyLight, sky: Sky, law: PhotometricLaw | None, look: Appearance, nearby: Nearby
) -> Floats:
    """Return the (N, 3) radiance of points under sun, sky and the ground nearby.

    Args:
        light: Of the sky.
        sky: Where the sun is.
        law: The law of reflection of the ground; None: that of rough surfaces.
        look: Of the points.
        nearby: The light there; ``free`` is changed.
    """
    normal, to_sun = look.normal, np.array(sky.to_sun, np.float32)
    rough = RoughDiffuse(look.albedo, look.roughness, dot(normal, nearby.to_eye))
    facing, bend_cos = dot(normal, to_sun), dot(normal, look.smooth)
    direct = nearby.sun_share * bent_share(facing, dot(look.smooth, to_sun), bend_cos)
    free, leaves = nearby.free, np.flatnonzero(look.through)
    if len(leaves):
        free[leaves] *= np.float32(FREE_OF_LEAVES)
    below = ground_share(normal, bend_cos, free, nearby.is_ground)
    ambient = rough.ambient()
    ambient *= _ambient(light, normal, free, below, nearby.ground)
    image = rough.radiance(facing, dot(nearby.to_eye, to_sun))
    for channel, sun in zip(image.T, sun_w_m2(sky), strict=True):
        channel[:] *= direct * sun
    if law is not None:
        _apply_law(law, sky, look, nearby, (image, ambient))
    image += ambient
    if len(leaves):
        some = Nearby(*(take(each, leaves) for each in nearby))
        of_leaves = Appearance(*(take(each, leaves) for each in look))
        through = _through_leaves(light, sky, of_leaves, some)
        before = take(image, leaves)
        put(image, leaves, before + of_leaves.through[:, None] * (through - before))
    return image


def _through_leaves(light: SkyLight, sky: Sky, look: Appearance, nearby: Nearby) -> Floats:
    """Return the (N, 3) radiance of leaves by what shines on their other side."""
    back = -look.normal
    behind = np.maximum(dot(back, np.array(sky.to_sun, np.float32)), 0) * nearby.sun_share
    below = (1 - back[:, 2]) * np.float32(0.5)
    found = _ambient(light, back, nearby.free, below, nearby.ground)
    for channel, sun in zip(found.T, sun_w_m2(sky), strict=True):
        channel[:] += behind * (sun * INVERSE_PI)
    found *= look.albedo
    for channel, share in zip(found.T, THROUGH_LEAF, strict=True):
        channel[:] *= np.float32(share)
    return found


def _ambient(
    light: SkyLight, normal: Floats, free: Floats, below: Floats, ground: Floats
) -> Floats:
    """Return the (N, 3) irradiance over pi of sky and ground together.

    Args:
        light: Of the sky.
        normal: (N, 3) of the surfaces.
        free: (N,) share of the sky that they see.
        below: (N,) share of their hemisphere in which they see ground below the horizon.
        ground: (N, 3) radiance of the ground nearby.
    """
    above = (1 + normal[:, 2]) * np.float32(0.5)
    found = light.irradiance(normal)
    found *= (free * INVERSE_PI)[:, None]
    found += (below + np.float32(HIDDEN_LIGHT) * above * (1 - free))[:, None] * ground
    return found


def _apply_law(
    law: PhotometricLaw,
    sky: Sky,
    look: Appearance,
    nearby: Nearby,
    lights: tuple[Floats, Floats],
) -> None:
    """Multiply, in place, what the ground reflects of the sun and of the sky."""
    on_ground = np.flatnonzero(nearby.is_ground)
    rays = -take(nearby.to_eye, on_ground)
    factors = law_factors(law, take(look.normal, on_ground), rays, sky.to_sun)
    for reflected, factor in zip(lights, factors, strict=True):
        put(reflected, on_ground, take(reflected, on_ground) * factor[:, None])
