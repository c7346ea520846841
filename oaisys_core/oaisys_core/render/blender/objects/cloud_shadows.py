"""Shadows of clouds in Blender: a level sheet at their undersides that only rays to lamps meet."""

from __future__ import annotations

from math import hypot
from typing import Any

import bpy
import numpy as np

from oaisys_core.procedural.environment.clouds.field import GRID
from oaisys_core.procedural.environment.clouds.shadows import CloudShadows
from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import NodeTree
from oaisys_core.render.blender.materials.surfaces import new_material

REACH_M = 150_000.0
"""Half the edge of the ground that gets shadows."""

CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))

UNSEEN_BY = ("camera", "diffuse", "glossy", "transmission", "volume_scatter")


class CloudSheet:
    """The sheet, made for the first clouds, and hidden while none cast shadows."""

    def __init__(self) -> None:
        self._sheet: Any = None
        self._shadows: CloudShadows | None = None

    def set(self, shadows: CloudShadows | None) -> None:
        """Take over shadows."""
        if shadows is self._shadows:
            return
        if self._sheet is None:
            self._sheet = _new_sheet()
        self._shadows = None
        self._sheet.hide_render = shadows is None
        if shadows is not None:
            reach_m = REACH_M + shadows.base_m * hypot(*shadows.per_m)
            self._sheet.location = (0.0, 0.0, shadows.base_m)
            self._sheet.scale = (reach_m, reach_m, 1.0)
            self._add_nodes(shadows)
        self._shadows = shadows

    def _add_nodes(self, shadows: CloudShadows) -> None:
        """Make the sheet let light through."""
        pixels = np.ones((GRID, GRID, 4), np.float32)
        pixels[..., :3] = shadows.share[..., None]
        image = new_image("cloud_shadows", pixels, is_float=True, is_color=False)
        tree = NodeTree(node_tree_of(self._sheet.data.materials[0]))
        # Texels of Blender's images have their middles at halves.
        start = [0.5 / GRID - shift_m / shadows.tile_m for shift_m in shadows.shift_m]
        place = tree.vector(
            "MULTIPLY_ADD",
            tree.add("NewGeometry").outputs["Position"],
            (1 / shadows.tile_m,) * 3,
            (*start, 0.0),
        )
        texel = tree.add("TexImage", {"Vector": place}, image=image, extension="REPEAT")
        color = texel.outputs["Color"]
        through = tree.add("BsdfTransparent", {"Color": color}).outputs[0]
        tree.add("OutputMaterial", {"Surface": through})


def _new_sheet() -> Any:
    mesh = bpy.data.meshes.new("cloud_shadows")
    mesh.from_pydata([(x, y, 0.0) for x, y in CORNERS], [], [tuple(range(4))])
    mesh.materials.append(new_material("cloud_shadows"))
    sheet: Any = bpy.data.objects.new("cloud_shadows", mesh)
    for ray in UNSEEN_BY:
        setattr(sheet, f"visible_{ray}", False)
    bpy.context.scene.collection.objects.link(sheet)
    return sheet
