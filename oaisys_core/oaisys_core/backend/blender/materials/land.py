"""Shader nodes for the place in the masks of the land around a stage, see `LandMasks`."""

from __future__ import annotations

from math import e, log, pi

from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket
from oaisys_core.terrain.surroundings.land_masks import LandMasks


def land_place(tree: NodeTree, land: LandMasks, position: Socket) -> Socket:
    """Return the place in images of the masks at a position, as `LandMasks.texels_at` does."""
    cx, cy = land.centre_m
    offset = tree.vector("MULTIPLY_ADD", position, (1.0, 1.0, 0.0), (-cx, -cy, 0.0))
    x, y, _ = tree.add("SeparateXYZ", {0: offset}).outputs
    u = tree.math("MULTIPLY", tree.math("ARCTAN2", y, x), 1 / (2 * pi))
    distance_m = tree.add("VectorMath", {0: offset}, operation="LENGTH").outputs["Value"]
    gain = land.rows_per_e_fold / land.rows
    start = 0.5 / land.rows - gain * log(land.nearest_m)
    v = tree.math("MULTIPLY_ADD", tree.math("LOGARITHM", distance_m, e), gain, start)
    v = tree.math("MINIMUM", tree.math("MAXIMUM", v, 0.5 / land.rows), 1 - 0.5 / land.rows)
    return tree.combined(u, v, 0.0)


def land_share(tree: NodeTree, land: LandMasks, position: Socket) -> Socket:
    """Return the weight of these masks over the stage's, as `LandMasks.share_at` does."""
    (cx, cy), (half_x, half_y) = land.centre_m, land.half_m
    offset = tree.vector("MULTIPLY_ADD", position, (1.0, 1.0, 0.0), (-cx, -cy, 0.0))
    beyond = tree.vector("SUBTRACT", tree.vector("ABSOLUTE", offset), (half_x, half_y, 0.0))
    outside = tree.vector("MAXIMUM", beyond, (0.0, 0.0, 0.0))
    distance_m = tree.add("VectorMath", {0: outside}, operation="LENGTH").outputs["Value"]
    return tree.clamped("MULTIPLY", distance_m, 1 / land.patch_m)
