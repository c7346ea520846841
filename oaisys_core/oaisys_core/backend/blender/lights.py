"""Sun and sky."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from oaisys_core.backend.blender.compat import SKY_SCALE, node_tree_of, set_up_sky_node
from oaisys_core.backend.blender.nodes import MIX_FIRST, MIX_RESULT, MIX_SECOND, NodeTree
from oaisys_core.scene import Sky

BLACK = (0.0, 0.0, 0.0, 1.0)

PLAIN_ALBEDO = np.array((0.26, 0.22, 0.18))
"""Linear colour of the far plain that is seen below the horizon, beyond the stage."""

SKY_IRRADIANCE_W_M2 = 0.65
"""Of the sky on level ground at a strength of 1, roughly: it only lights the far plain."""

HAZE_RADIANCE = np.array((0.55, 0.62, 0.65))
"""Of the air above the horizon, before the sun's colour; near what the sky models give there."""

HAZE_DEPTH = 0.07
"""Downward component of a ray at which the plain shows through the haze by 1 - 1 / e."""

RAYLEIGH_OPTICAL_DEPTH = np.array((0.040, 0.097, 0.242))
"""Of the whole atmosphere towards the zenith at 680, 550 and 440 nm."""


class Lights:
    """A sun lamp, whose disc casts the shadows, and a sky without the disc.

    Light from a lamp converges with far fewer samples than from a bright spot in the sky.
    """

    def __init__(self) -> None:
        lamp = bpy.data.lights.new("sun", "SUN")
        self._sun = bpy.data.objects.new("sun", lamp)
        bpy.context.scene.collection.objects.link(self._sun)
        world = bpy.data.worlds.new("world")
        bpy.context.scene.world = world
        tree = NodeTree(node_tree_of(world))
        self._sky_node = tree.add("TexSky")
        ray = tree.add("SeparateXYZ", {0: tree.add("TexCoord").outputs["Generated"]})
        self._sky = tree.add("VectorMath", {0: self._sky_node.outputs[0]}, operation="SCALE")
        up = ray.outputs["Z"]
        haze = tree.math("EXPONENT", tree.math("DIVIDE", up, HAZE_DEPTH))
        self._plain = tree.color_mix(haze, BLACK, BLACK)
        is_below = tree.math("LESS_THAN", up, 0.0)
        seen = tree.color_mix(is_below, self._sky.outputs[0], self._plain.outputs[MIX_RESULT])
        background = tree.add("Background", {"Color": seen.outputs[MIX_RESULT]})
        tree.add("OutputWorld", {"Surface": background.outputs[0]})

    def set(self, sky: Sky) -> None:
        """Make light and sky so."""
        elevation, azimuth = sky.sun_elevation_rad, sky.sun_azimuth_rad
        to_sun = Vector(
            (cos(elevation) * cos(azimuth), cos(elevation) * sin(azimuth), sin(elevation))
        )
        self._sun.rotation_mode = "QUATERNION"
        self._sun.rotation_quaternion = to_sun.to_track_quat("Z", "Y")
        lamp: Any = self._sun.data
        lamp.energy = sky.sun_strength_w_m2 if elevation > 0 else 0.0
        lamp.angle = sky.sun_angular_diameter_rad
        lamp.color = sun_color(sky)
        set_up_sky_node(self._sky_node, sky.air, sky.dust, sky.ozone)
        self._sky_node.sun_elevation = elevation
        self._sky_node.sun_rotation = pi / 2 - azimuth
        self._sky.inputs["Scale"].default_value = SKY_SCALE * sky.sky_strength
        self._plain.inputs[MIX_FIRST].default_value = (*plain_radiance(sky), 1.0)
        self._plain.inputs[MIX_SECOND].default_value = (*haze_radiance(sky), 1.0)


def sun_color(sky: Sky) -> tuple[float, float, float]:
    """Return the colour of direct sunlight: white less what the air scatters out of its path.

    Air mass by Kasten and Young (1989).
    """
    degrees = max(np.degrees(sky.sun_elevation_rad), 0.0)
    air_mass = 1.0 / (np.sin(np.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364)
    red, green, blue = np.exp(-RAYLEIGH_OPTICAL_DEPTH * sky.air * air_mass)
    return (1.0, float(green / red), float(blue / red))


def plain_radiance(sky: Sky) -> tuple[float, float, float]:
    """Return the radiance of a dull level plain under sun and sky (Lambert)."""
    sun_w_m2 = sky.sun_strength_w_m2 * max(sin(sky.sun_elevation_rad), 0.0)
    irradiance = sun_w_m2 * np.array(sun_color(sky)) + SKY_IRRADIANCE_W_M2 * sky.sky_strength
    red, green, blue = (PLAIN_ALBEDO * irradiance / pi).tolist()
    return (red, green, blue)


def haze_radiance(sky: Sky) -> tuple[float, float, float]:
    """Return the colour that the far plain fades into: that of the sky just above it, roughly."""
    twilight = min(max(1.0 + np.degrees(sky.sun_elevation_rad) / 8.0, 0.0), 1.0)
    color = HAZE_RADIANCE * np.sqrt(sun_color(sky)) * sky.sky_strength * twilight
    red, green, blue = color.tolist()
    return (red, green, blue)
