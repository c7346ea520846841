"""What tests of the ground's material have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
from synthetic_worlds import settings

from oaisys_core.backend.blender import BlenderBackend
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import Frame, Progress


def ignore(progress: Progress) -> None:
    """Do nothing with it."""


def views(cases: Sequence[tuple[Scene, PlacedCamera]]) -> list[tuple[Frame, ...]]:
    """Frames of one camera in each world."""
    backend = BlenderBackend()
    frames = []
    for scene, camera in cases:
        backend.build(scene, ignore)
        frames.append(backend.render_all([camera], settings(samples=16), ignore))
    return frames


def blocks(scenes: Sequence[Scene]) -> list[dict[str, int]]:
    """How many images, materials and node groups there are after each world was built."""
    backend = BlenderBackend()
    counts = []
    for scene in scenes:
        backend.build(scene, ignore)
        kinds = ("images", "materials", "node_groups")
        counts.append({kind: len(getattr(bpy.data, kind)) for kind in kinds})
    return counts


def lookups_by_level(scene: Scene) -> list[set[tuple[str, float]]]:
    """Which images each level of the ground's textures looks up, and how far aside, in tiles."""
    BlenderBackend().build(scene, ignore)
    groups = [g for g in bpy.data.node_groups if g.name.startswith("ground_level")]
    return [
        {
            _lookup(node)
            for layer in level.nodes
            if layer.type == "GROUP" and layer.node_tree.name.startswith("ground_layer")
            for node in layer.node_tree.nodes
            if node.type == "TEX_IMAGE"
        }
        for level in groups
    ]


def _lookup(texel: Any) -> tuple[str, float]:
    """An image and the horizontal shift of its coordinates."""
    link = texel.inputs["Vector"].links[0].from_node
    if link.type == "VECT_MATH":
        return texel.image.name, link.inputs[2].default_value[0]
    return texel.image.name, texel.texture_mapping.translation[0]
