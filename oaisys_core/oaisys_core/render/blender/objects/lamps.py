"""Lamps in Blender: its point, spot and area lights."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from oaisys_core.scene.lamps import Lamp


class LampObjects:
    """The lamps of Blender's scene."""

    def __init__(self) -> None:
        self._lamps: tuple[Lamp, ...] = ()
        self._objects: list[Any] = []

    def set(self, lamps: tuple[Lamp, ...]) -> bool:
        """Take over lamps in ``map``; return whether their number or a kind changed.

        Lamps that did not change are not written, because even the same value marks them as
        changed.
        """
        before, self._lamps = self._lamps, lamps
        are_others = [lamp.kind for lamp in lamps] != [lamp.kind for lamp in before]
        if are_others:
            self._replace()
            before = ()
        for index, (lamp, thing) in enumerate(zip(lamps, self._objects, strict=True)):
            if not before or lamp != before[index]:
                _write(lamp, thing)
        return are_others

    def _replace(self) -> None:
        """Make all lamps anew, so that Blender has them in the same order whatever was before."""
        lights = [thing.data for thing in self._objects]
        bpy.data.batch_remove([*self._objects, *lights])
        self._objects = [_new_object(lamp) for lamp in self._lamps]


def _new_object(lamp: Lamp) -> Any:
    name = f"lamp_{lamp.name}"
    light = bpy.data.lights.new(name, lamp.kind.upper())
    thing = bpy.data.objects.new(name, light)
    # Neither depth nor labels show lamps.
    thing.visible_camera = False
    bpy.context.scene.collection.objects.link(thing)
    return thing


def _write(lamp: Lamp, thing: Any) -> None:
    """Set pose and light of a lamp."""
    T = np.eye(4)
    # Blender's lights shine along -z.
    T[:3, :3] = np.column_stack((lamp.right, lamp.up, -np.array(lamp.forward)))
    T[:3, 3] = lamp.position_m
    thing.matrix_world = Matrix(T)
    light = thing.data
    light.energy = lamp.strength_w
    light.color = lamp.color
    if lamp.kind == "area":
        light.shape = "RECTANGLE"
        light.size, light.size_y = lamp.width_m, lamp.height_m
        return
    light.shadow_soft_size = lamp.radius_m
    # Else surfaces within the radius would receive less light than by the inverse square law.
    light.use_soft_falloff = False
    if lamp.kind == "spot":
        light.spot_size, light.spot_blend = lamp.cone_rad, lamp.cone_softness
