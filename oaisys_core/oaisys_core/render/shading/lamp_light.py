"""Light of lamps on surfaces, in closed form and without shadows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import cos, pi

import numpy as np

from oaisys_core.scene.lamps import Lamp
from oaisys_core.types import FloatArray

MIN_M = 1e-6
"""Least distance from a lamp, where its light is infinite."""


def lamp_irradiance_w_m2(
    lamps: Sequence[Lamp], points_m: FloatArray, normals: FloatArray
) -> FloatArray:
    """Return the (N, 3) irradiance by colour of lamps in ``map`` at (N, 3) points.

    Args:
        lamps: The lamps.
        points_m: Points in ``map``.
        normals: (N, 3) unit normals of the surface there.
    """
    irradiance = np.zeros_like(points_m)
    for lamp in lamps:
        of_kind = _area if lamp.kind == "area" else _sphere
        of_lamp = of_kind(lamp, points_m, normals)
        irradiance += of_lamp[:, None] * np.array(lamp.color)
    return irradiance


def cone_share(lamp: Lamp, cosines: FloatArray) -> FloatArray:
    """Return the share of a spot's intensity by the cosine of the angle from its axis.

    It is Blender's: 0 outside the cone, 1 inside, and between them smooth in the cosine.
    """
    edge = cos(lamp.cone_rad / 2)
    fade = max((1 - edge) * lamp.cone_softness, 1e-9)
    inside = np.clip((cosines - edge) / fade, 0.0, 1.0)
    return np.asarray(inside * inside * (3 - 2 * inside))


def _sphere(lamp: Lamp, points_m: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the (N,) irradiance of a point or spot lamp, all of it above the horizon."""
    to_lamp = np.array(lamp.position_m) - points_m
    distance_m = np.maximum(np.linalg.norm(to_lamp, axis=1), max(lamp.radius_m, MIN_M))
    facing = np.maximum((to_lamp * normals).sum(axis=1), 0.0) / distance_m
    irradiance = lamp.strength_w / (4 * pi) * facing / distance_m**2
    if lamp.kind == "spot":
        irradiance = irradiance * cone_share(lamp, -(to_lamp @ np.array(lamp.forward)) / distance_m)
    return np.asarray(irradiance)


def _area(lamp: Lamp, points_m: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the (N,) irradiance of an area lamp, by Lambert's formula for polygons.

    It is exact unless the plane of the surface cuts the lamp.
    """
    right = np.array(lamp.right) * lamp.width_m / 2
    up = np.array(lamp.up) * lamp.height_m / 2
    centre = np.array(lamp.position_m)
    corners = [centre + a * right + b * up for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    # Counter-clockwise as seen from the lamp's front.
    rays = [_unit(corner - points_m) for corner in corners]
    # The sum is twice the projected solid angle.
    projected = np.zeros(len(points_m))
    for first, second in pairwise([*rays, rays[0]]):
        cross = np.cross(first, second)
        sine = np.maximum(np.linalg.norm(cross, axis=1), 1e-300)
        angle = np.arctan2(sine, (first * second).sum(axis=1))
        projected += angle / sine * (cross * normals).sum(axis=1)
    in_front = (points_m - centre) @ np.array(lamp.forward) > 0
    radiance = lamp.strength_w / (pi * lamp.width_m * lamp.height_m)
    return np.asarray(radiance * np.maximum(projected / 2, 0.0) * in_front)


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), MIN_M)
    return np.asarray(vectors / length)
