"""The sun's lamp, and the air that veils what is far."""

from __future__ import annotations

from typing import Any

import bpy
from mathutils import Vector

from oaisys_core.backend.blender.materials.haze import set_haze
from oaisys_core.backend.blender.objects.sky import Background
from oaisys_core.environment.light import sun_color
from oaisys_core.sky import Sky


class Lights:
    """A sun lamp, whose disc casts the shadows, and a sky without the disc.

    Light from a lamp converges with far fewer samples than from a bright spot in the sky.
    """

    def __init__(self) -> None:
        lamp = bpy.data.lights.new("sun", "SUN")
        self._sun = bpy.data.objects.new("sun", lamp)
        bpy.context.scene.collection.objects.link(self._sun)
        self._background = Background()
        self._sky: Sky | None = None

    def set(self, sky: Sky) -> bool:
        """Make light and sky so; return whether they were another."""
        if sky == self._sky:
            return False
        self._sky = sky
        self._sun.rotation_mode = "QUATERNION"
        self._sun.rotation_quaternion = Vector(sky.to_sun).to_track_quat("Z", "Y")
        lamp: Any = self._sun.data
        lamp.energy = sky.lamp_w_m2
        lamp.angle = sky.sun_angular_diameter_rad
        lamp.color = sun_color(sky)
        # Else each light sample would ask how bright a dark lamp is.
        self._sun.hide_render = sky.lamp_w_m2 <= 0
        self._background.set(sky)
        set_haze(sky)
        return True
