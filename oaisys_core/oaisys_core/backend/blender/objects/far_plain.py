"""The ground beyond the stage as Blender's object: see `oaisys_core.backend.raycast.far_plain`."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from oaisys_core.backend.blender.objects.meshes import new_mesh, new_object
from oaisys_core.backend.raycast.far_plain import LEVEL, SLOPE, rings, stage_of
from oaisys_core.scene import Scene

PLAIN = "plain"
"""Name of the object and its mesh."""


class Plain:
    """What goes on beyond the stage, with the ground's material."""

    def __init__(self) -> None:
        self._thing: Any = None

    def clear(self) -> None:
        """Remove it, so that nothing uses the ground's material any more."""
        if self._thing is not None:
            bpy.data.meshes.remove(self._thing.data)
        self._thing = None

    def build(self, scene: Scene, material: Any) -> None:
        """Make it around a scene's ground."""
        self.clear()
        triangles = rings(stage_of(scene.ground), (*SLOPE, *LEVEL))
        mesh = new_mesh(PLAIN, *triangles, smooth=True)
        mesh.materials.append(material)
        self._thing = new_object(PLAIN, mesh, np.eye(4))

    def show(self, is_shown: bool) -> None:
        """Let it be seen or not."""
        # To set what is set already has Blender look at the whole scene again.
        if self._thing is not None and self._thing.hide_render == is_shown:
            self._thing.hide_render = not is_shown
