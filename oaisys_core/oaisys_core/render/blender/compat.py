"""Differences between Blender 4.5 LTS and 5.2 LTS."""

from __future__ import annotations

from math import pi
from typing import Any

import bpy

from oaisys_core.scene.sky import Sky

IS_BLENDER_5 = bpy.app.version >= (5, 0, 0)

SKY_SCALE = 0.0495
"""Factor on the sky model's radiance: level ground then receives `SKY_IRRADIANCE_W_M2` from the sky
at a sun elevation of 38 degrees."""


def node_tree_of(owner: Any) -> Any:
    """Return the node tree of a material or world, without nodes (4.5 creates it on demand)."""
    if owner.node_tree is None:
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def set_up_sky_node(node: Any, sky: Sky) -> None:
    """Set the physical sky model and its parameters, without the sun's disc.

    It is that of single scattering in both, as drafts and metering take it to be.
    """
    node.sky_type = "SINGLE_SCATTERING" if IS_BLENDER_5 else "NISHITA"
    node.sun_disc = False
    node.sun_elevation = sky.sun_elevation_rad
    # Blender measures clockwise from +y.
    node.sun_rotation = pi / 2 - sky.sun_azimuth_rad
    node.altitude = sky.altitude_m
    node.air_density = sky.air
    setattr(node, "aerosol_density" if IS_BLENDER_5 else "dust_density", sky.dust)
    node.ozone_density = sky.ozone


DIFFUSE_COLOR = "Diffuse Color" if IS_BLENDER_5 else "DiffCol"
"""Name of the albedo pass."""

MATERIAL_INDEX = "Material Index" if IS_BLENDER_5 else "IndexMA"
"""Name of the pass with the materials' indices."""

GLOSSY_COLOR = "Glossy Color" if IS_BLENDER_5 else "GlossCol"
"""Name of the pass with the share of light that films of water and ice reflect."""
