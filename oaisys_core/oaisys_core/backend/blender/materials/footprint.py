"""How much of a surface a pixel covers, in materials: which level of a texture is to be seen.

Cycles has no mip maps on the processor. A mixture of surfaces, of which one alone shows at each
point, stands in for them: only that one is evaluated.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log2
from typing import Any

import bpy

from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket

GROUP = "footprint"
"""Node group that all materials share, so that another camera rebuilds none of them."""

ANGLE = "angle"
"""Its node that multiplies by the angle of a pixel."""

STEPS = 4
"""Angles are told apart by this share of an octave: similar cameras are one to the materials."""

PIXELS = 2.0
"""Of the camera's, that count as one here: texels are then one to two pixels large. Smaller ones
(Nyquist) a light sample per pixel sees by chance, which is two decibels of noise on sunlit gravel.
"""


def set_pixel_angle(angle_rad: float) -> None:
    """Set the angle that a pixel of the camera spans; nothing happens for a similar one."""
    angle = _group().nodes[ANGLE].inputs[1]
    wanted = PIXELS * 2.0 ** (floor(STEPS * log2(angle_rad) + 1e-6) / STEPS)
    if abs(angle.default_value - wanted) > 1e-6 * wanted:
        angle.default_value = wanted


def by_footprint(tree: NodeTree, bounds_m: Sequence[float], surfaces: Sequence[Socket]) -> Socket:
    """Return the first surface below the first bound, and from each bound on the next one.

    Args:
        tree: Of the material.
        bounds_m: Footprints of a pixel, from the smallest on.
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
    # Outlives a purge between two worlds.
    group.use_fake_user = True
    group.interface.new_socket("Metres", in_out="OUTPUT", socket_type="NodeSocketFloat")
    tree = NodeTree(group)
    away_m = tree.add("CameraData").outputs["View Distance"]
    covered = tree.add("Math", {0: away_m, 1: 0.0}, operation="MULTIPLY", name=ANGLE)
    tree.connect(covered.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    return group
