"""Levels of detail in materials, chosen by the footprint of a pixel on the surface.

Cycles has no mip maps on the CPU. Instead, a material mixes one surface per level with weights of
0 and 1, of which Cycles evaluates only one.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log2
from typing import Any

import bpy

from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket

GROUP = "footprint"
"""Node group that all materials share, so that a change of camera rebuilds none of them."""

ANGLE = "angle"
"""Name of its node that multiplies by the angle of a pixel."""

STEPS = 4
"""Steps per octave that angles are rounded to, so that similar cameras change nothing."""

PIXELS = 2.0
"""Pixels per footprint, so that a texel is one to two pixels large (Nyquist)."""


def set_pixel_angle(angle_rad: float) -> None:
    """Set the angle that a pixel of the camera spans, unless it is similar to the current one."""
    angle = _group().nodes[ANGLE].inputs[1]
    wanted = PIXELS * 2.0 ** (floor(STEPS * log2(angle_rad) + 1e-6) / STEPS)
    if abs(angle.default_value - wanted) > 1e-6 * wanted:
        angle.default_value = wanted


def by_footprint(tree: NodeTree, bounds_m: Sequence[float], surfaces: Sequence[Socket]) -> Socket:
    """Return a surface that switches from one to the next at footprints of a pixel.

    Args:
        tree: The material's.
        bounds_m: Footprints in ascending order.
        surfaces: One more than bounds.
    """
    result = surfaces[-1]
    if bounds_m:
        seen_m = tree.add("Group", node_tree=_group()).outputs[0]
    for bound_m, surface in zip(reversed(bounds_m), reversed(surfaces[:-1]), strict=True):
        is_beyond = tree.math("GREATER_THAN", seen_m, bound_m)
        result = tree.mixed(is_beyond, surface, result)
    return result


def _group() -> Any:
    group = bpy.data.node_groups.get(GROUP)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    # Keeps it through a purge between two worlds.
    group.use_fake_user = True
    group.interface.new_socket("Metres", in_out="OUTPUT", socket_type="NodeSocketFloat")
    tree = NodeTree(group)
    away_m = tree.add("CameraData").outputs["View Distance"]
    covered = tree.add("Math", {0: away_m, 1: 0.0}, operation="MULTIPLY", name=ANGLE)
    tree.connect(covered.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    return group
