"""What tests of the ground's material have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import bpy
import numpy as np
from synthetic_worlds import settings

from oaisys_core.backend.blender import BlenderBackend, postprocessing
from oaisys_core.backend.blender.cycles import Cycles
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


def albedos(
    cases: Sequence[tuple[Scene, PlacedCamera]], few: int, many: int
) -> list[dict[str, Any]]:
    """The albedo that few and many samples see in each view, and the ground's without noise."""
    backend = BlenderBackend()
    tone_map = Cycles.denoise_and_tonemap
    given: list[Any] = []

    def kept(
        cycles: Cycles, rendered: Any, wanted: Any, denoising: Any, ground: Any, gains: Any
    ) -> Any:
        given.append((rendered.passes[postprocessing.SEEN_ALBEDO], ground))
        return tone_map(cycles, rendered, wanted, denoising, ground, gains)

    with mock.patch.object(Cycles, "denoise_and_tonemap", kept):
        for scene, camera in cases:
            backend.build(scene, ignore)
            for samples in (few, many):
                wanted = replace(settings(samples), denoise=True)
                backend.render_all([camera], wanted, ignore)
    found = []
    for (seen_by_few, ground), (seen_by_many, _) in zip(given[::2], given[1::2], strict=True):
        nothing = np.zeros(seen_by_few.shape[:2], bool)
        found.append(
            {
                "few": np.ascontiguousarray(seen_by_few),
                "many": np.ascontiguousarray(seen_by_many),
                "clean": None if ground is None else ground.linear,
                "known": nothing if ground is None else ground.is_known,
            }
        )
    return found
