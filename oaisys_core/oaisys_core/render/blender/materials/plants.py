"""Materials of plants: leaves that let light through, rows of needles, and bark."""

from __future__ import annotations

from typing import Any

import numpy as np

from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.footprint import footprint_group
from oaisys_core.render.blender.materials.haze import through_haze
from oaisys_core.render.blender.materials.mesh_materials import CUT_OUT
from oaisys_core.render.blender.materials.nodes import MIX_RESULT, NodeTree, Socket
from oaisys_core.render.blender.materials.surfaces import (
    PAINT,
    diffuse,
    new_material,
    paint_vertices,
    show,
)
from oaisys_core.render.shading.looks import OBJECT_ROUGHNESS, PLANT_TINTS, THROUGH_LEAF
from oaisys_core.scene import MeshPrototype
from oaisys_core.scene.objects import FIRST_NEEDLE, NEEDLE_STEP

GAPS = 0.5
"""Share of a row of needles that is open near the camera."""

OPEN_PX_M, CLOSED_PX_M = 0.003, 0.012
"""Sizes of a pixel on a row up to which it is open, and from which it is closed: needles are 1 to
2 mm wide, and each gap that a camera ray passes costs a hit."""

NEEDLE_TONES = (0.75, 0.5)
"""Brightness of the darkest needle of a row, and by how much the brightest one is brighter."""

PLATE_M, PLATE_STRETCH = 0.03, 0.3
"""Width of the plates of bark, and their width over their length."""

FURROW = 0.22
"""Width of the furrows between plates, in units of their width, from middle to rim."""

FURROW_M, FURROW_SHADE, PLATE_SHADE = 0.008, 0.4, 0.7
"""Depth of the furrows, how much darker they are, and how much plates differ."""

SMOOTH_RED, ROUGH_RED = 0.4, 0.15
"""Linear red of bark from which it has no furrows, as of birches, and up to which it has deep
ones."""


def plant_material(prototype: MeshPrototype, mesh: Any) -> Any:
    """Return a material of a prototype with translucency and vertex colours."""
    result = new_material(prototype.name)
    tree = NodeTree(node_tree_of(result))
    light, needles = np.asarray(prototype.translucency), prototype.needles
    alpha = light if needles is None else np.where(light > 0, needles, 0).astype(np.uint8)
    paint_vertices(prototype, mesh, alpha)
    paint = tree.add("Attribute", attribute_name=PAINT)
    color, share = _tinted(tree, paint.outputs["Color"]), paint.outputs["Alpha"]
    is_organ = tree.math("GREATER_THAN", share, 0.5 / 255)
    is_gap: Socket = None
    organ_color = color
    if needles is not None:
        number = tree.math("MULTIPLY_ADD", share, 255 / NEEDLE_STEP, -FIRST_NEEDLE / NEEDLE_STEP)
        share = float(light.max()) / 255
        is_gap = tree.math("MULTIPLY", is_organ, _gap(tree, number))
        organ_color = _needle_color(tree, color, number)
    surface, airlight = diffuse(tree, organ_color, OBJECT_ROUGHNESS, None)
    through, _ = through_haze(tree, tree.vector("MULTIPLY", organ_color, THROUGH_LEAF))
    behind = tree.add("BsdfTranslucent", {"Color": through}).outputs[0]
    organ = tree.mix(share, surface, behind)
    both = tree.mix(is_organ, _bark(tree, color), organ)
    if is_gap is None:
        show(tree, both, airlight)
        return result
    result[CUT_OUT] = True
    # Shadows of needles are as dense as those of the rows that stand for them.
    result.use_transparent_shadow = False
    air = tree.add("Emission", {"Color": airlight}).outputs[0]
    seen = tree.add("AddShader", {0: both, 1: air}).outputs[0]
    clear = tree.add("BsdfTransparent").outputs[0]
    tree.add("OutputMaterial", {"Surface": tree.mix(is_gap, seen, clear)})
    return result


def _tinted(tree: NodeTree, color: Socket) -> Socket:
    """Return a colour with the tint of the instance: individuals differ."""
    least, most = PLANT_TINTS
    random = tree.add("ObjectInfo").outputs["Random"]
    tint = tree.color_mix(random, (*least, 1.0), (*most, 1.0)).outputs[MIX_RESULT]
    return tree.vector("MULTIPLY", color, tint)


def _gap(tree: NodeTree, number: Socket) -> Socket:
    """Return 1 where a camera ray passes between the needles of a row, from their numbers."""
    seen_m = tree.add("Group", node_tree=footprint_group()).outputs[0]
    span_m = CLOSED_PX_M - OPEN_PX_M
    closed = tree.clamp("MULTIPLY_ADD", seen_m, 1 / span_m, -OPEN_PX_M / span_m)
    half = tree.math("MULTIPLY_ADD", closed, GAPS / 2, (1 - GAPS) / 2)
    is_beside = tree.math("GREATER_THAN", tree.math("PINGPONG", number, 0.5), half)
    return tree.math("MULTIPLY", is_beside, tree.add("LightPath").outputs["Is Camera Ray"])


def _needle_color(tree: NodeTree, color: Socket, number: Socket) -> Socket:
    """Return the colour of a needle of a row: each has its own brightness."""
    nearest = tree.math("ROUND", number)
    chance = tree.add("TexWhiteNoise", {"W": nearest}, noise_dimensions="1D").outputs["Value"]
    least, range_ = NEEDLE_TONES
    return tree.scale(color, tree.math("MULTIPLY_ADD", chance, range_, least))


def _bark(tree: NodeTree, color: Socket) -> Socket:
    """Return bark of a colour, with plates between upright furrows."""
    position = tree.add("NewGeometry").outputs["Position"]
    place = tree.vector("MULTIPLY", position, tuple(np.array((1, 1, PLATE_STRETCH)) / PLATE_M))
    noise = tree.add("TexNoise", {"Vector": place, "Scale": 1.3, "Detail": 3.0})
    bent = tree.vector("MULTIPLY_ADD", noise.outputs["Color"], 0.9, place)
    edge = tree.add("TexVoronoi", {"Vector": bent, "Scale": 1.0}, feature="DISTANCE_TO_EDGE")
    plate = tree.clamp("MULTIPLY", edge.outputs["Distance"], 1 / FURROW)
    red_span = SMOOTH_RED - ROUGH_RED
    red = tree.component(color, 0)
    depth = tree.clamp("MULTIPLY_ADD", red, -1 / red_span, SMOOTH_RED / red_span)
    grain = tree.math("SUBTRACT", noise.outputs[0], 0.5)
    height = tree.math("MULTIPLY", tree.math("MULTIPLY_ADD", grain, 0.8, plate), depth)
    shade = tree.math("MULTIPLY_ADD", plate, FURROW_SHADE, -FURROW_SHADE)
    shade = tree.math("MULTIPLY_ADD", grain, 2 * PLATE_SHADE, shade)
    bright = tree.math("MAXIMUM", tree.math("MULTIPLY_ADD", shade, depth, 1.0), 0.2)
    bump = tree.add("Bump", {"Height": height, "Distance": FURROW_M, "Strength": 1.0})
    surface, _ = diffuse(tree, tree.scale(color, bright), OBJECT_ROUGHNESS, bump.outputs[0])
    return surface
