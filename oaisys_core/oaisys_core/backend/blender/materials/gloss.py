"""Gloss on wet or frozen ground: a reflection over what lies below, where roughness is low."""

from __future__ import annotations

import numpy as np

from oaisys_core.backend.blender.materials.haze import through_haze
from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket
from oaisys_core.world.terrain_material import PbrMaps

IOR = 1.33
"""Refractive index of water; ice has 1.31."""

SHINY, DULL = 0.25, 0.6
"""Roughness up to which a film of water or ice is whole, and from which there is none."""

SHINY_SHARE = 0.01
"""Share of a texture that must be shinier than dull for the ground to have gloss at all: on dry
ground, gloss costs noise and shows nothing."""


def is_glossy(maps: PbrMaps) -> bool:
    """Return whether a texture set has parts that shine."""
    shiny = np.count_nonzero(maps.roughness < DULL * 255)
    return bool(shiny > SHINY_SHARE * maps.roughness.size)


def glossed(tree: NodeTree, surface: Socket, roughness: Socket, normal: Socket) -> Socket:
    """Return a surface under a film that reflects by Fresnel's law where it is not dull.

    Args:
        tree: The material's.
        surface: What is below the film.
        roughness: 0 to 1.
        normal: In ``map``, unit length.
    """
    slope = 1 / (DULL - SHINY)
    film = tree.clamped("MULTIPLY_ADD", roughness, -slope, DULL * slope)
    fresnel = tree.add("Fresnel", {"IOR": IOR, "Normal": normal}).outputs[0]
    seen, _ = through_haze(tree, (1.0, 1.0, 1.0, 1.0))
    inputs: dict[str | int, Socket] = {"Color": seen, "Roughness": roughness, "Normal": normal}
    mirror = tree.add("BsdfGlossy", inputs).outputs[0]
    return tree.mixed(tree.math("MULTIPLY", fresnel, film), surface, mirror)
