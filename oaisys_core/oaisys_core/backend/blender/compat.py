"""What differs between Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

from typing import Any

import bpy

IS_BLENDER_5 = bpy.app.version >= (5, 0, 0)

SKY_SCALE = 0.05 if IS_BLENDER_5 else 0.075
"""Factor on the sky model's radiance that gives level ground about 0.65 W/m² from the sky when
the sun stands at 38 degrees: a fifth of what comes from a sun of 4 W/m², and neutral with it."""


def node_tree_of(owner: Any) -> Any:
    """Return the emptied node tree of a material or world (4.5 makes it on demand)."""
    if owner.node_tree is None:
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def set_up_sky_node(node: Any, air: float, dust: float, ozone: float) -> None:
    """Choose the physical sky model and its densities, without the sun's disc."""
    node.sky_type = "MULTIPLE_SCATTERING" if IS_BLENDER_5 else "NISHITA"
    node.sun_disc = False
    node.air_density = air
    setattr(node, "aerosol_density" if IS_BLENDER_5 else "dust_density", dust)
    node.ozone_density = ozone
