"""Shader nodes of the land around a stage: places in its masks, and its fine relief."""

from __future__ import annotations

from math import e, log, pi
from typing import Any

import numpy as np

from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.scene.surroundings import LandDetail, LandMasks
from oaisys_core.types import Extent

RANGE = 12.0
"""Standard deviations of heights between 0 and 1 in an image: more than there are."""


def land_place(tree: NodeTree, land: LandMasks, position: Socket) -> Socket:
    """Return the place in images of the masks at a position, as `LandMasks.texels_at` does."""
    cx, cy = land.centre_m
    offset = tree.vector("MULTIPLY_ADD", position, (1.0, 1.0, 0.0), (-cx, -cy, 0.0))
    x, y = tree.component(offset, 0), tree.component(offset, 1)
    u = tree.math("MULTIPLY", tree.math("ARCTAN2", y, x), 1 / (2 * pi))
    distance_m = tree.add("VectorMath", {0: offset}, operation="LENGTH").outputs["Value"]
    gain = land.rows_per_e_fold / land.rows
    start = 0.5 / land.rows - gain * log(land.nearest_m)
    v = tree.math("MULTIPLY_ADD", tree.math("LOGARITHM", distance_m, e), gain, start)
    v = tree.math("MINIMUM", tree.math("MAXIMUM", v, 0.5 / land.rows), 1 - 0.5 / land.rows)
    return tree.combine(u, v, 0.0)


def land_share(tree: NodeTree, land: LandMasks, position: Socket) -> Socket:
    """Return the weight of these masks over the stage's, as `LandMasks.share_at` does."""
    return tree.clamp("MULTIPLY", _distance_m(tree, land.extent_m, position), 1 / land.patch_m)


def land_relief(tree: NodeTree, detail: LandDetail, extent_m: Extent) -> Socket:
    """Return heights of relief that the land's mesh is too coarse for.

    Cycles derives their slopes from neighbouring pixels, so that waves shorter than these vanish.
    """
    image = _relief_image(detail)
    position = tree.add("NewGeometry").outputs["Position"]
    distance_m = _distance_m(tree, extent_m, position)
    height_m: Socket = 0.0
    for band in detail.bands:
        texel = tree.add("TexImage", {"Vector": position}, image=image)
        texel.texture_mapping.rotation[2] = band.turn_rad
        texel.texture_mapping.scale = (1.0 / band.period_m,) * 3
        texel.texture_mapping.translation = (*band.start, 0.0)
        share = tree.clamp("MULTIPLY", distance_m, 1 / band.complete_m)
        raised = tree.math("MULTIPLY", texel.outputs["Alpha"], band.deviation_m * RANGE)
        height_m = tree.math("MULTIPLY_ADD", raised, share, height_m)
    return height_m


def _relief_image(detail: LandDetail) -> Any:
    pattern = detail.pattern
    pixels = np.empty((*pattern.shape, 4), np.float32)
    # In alpha, which needs no conversion to a number.
    pixels[...] = (pattern / RANGE + 0.5)[..., None]
    return new_image("land_relief", pixels, is_float=True, is_color=False)


def _distance_m(tree: NodeTree, extent_m: Extent, position: Socket) -> Socket:
    """Return the distance from the stage's edge, 0 on the stage."""
    x0, y0, x1, y1 = extent_m
    cx, cy, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    offset = tree.vector("MULTIPLY_ADD", position, (1.0, 1.0, 0.0), (-cx, -cy, 0.0))
    beyond = tree.vector("SUBTRACT", tree.vector("ABSOLUTE", offset), (half_x, half_y, 0.0))
    outside = tree.vector("MAXIMUM", beyond, (0.0, 0.0, 0.0))
    return tree.add("VectorMath", {0: outside}, operation="LENGTH").outputs["Value"]
