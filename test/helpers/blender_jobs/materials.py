"""What tests of the ground's material have done in Blender's own process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import bpy
import numpy as np
from coarse_clouds import coarse_clouds
from synthetic_worlds import settings

from oaisys_core.render.blender import BlenderBackend, postprocessing
from oaisys_core.render.blender.cycles import Cycles
from oaisys_core.render.blender.materials.footprint import set_pixel_angle
from oaisys_core.render.draft.frames import DRAFT
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.sensing.render_settings import RenderSettings
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


def rendered_after(
    scene: Scene, before: Sequence[PlacedCamera], camera: PlacedCamera
) -> tuple[tuple[Frame, ...], set[str]]:
    """Frames of a camera after those of others, and the kinds of data that it changed.

    Cycles compiles materials again if one of them, or a tree of its nodes, has changed.
    """
    backend = BlenderBackend()
    backend.build(scene, ignore)
    for other in before:
        backend.render_all([other], settings(samples=4), ignore)
    kinds: set[str] = set()

    def note(_: Any, graph: Any) -> None:
        kinds.update(type(update.id).__name__ for update in graph.updates)

    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        set_pixel_angle(camera.intrinsics)
        bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(note)
    return backend.render_all([camera], settings(samples=4), ignore), kinds


def blocks(scenes: Sequence[Scene]) -> list[dict[str, int]]:
    """How many images, materials and node groups there are after each world was built."""
    backend = BlenderBackend()
    counts = []
    for scene in scenes:
        backend.build(scene, ignore)
        kinds = ("images", "materials", "node_groups")
        counts.append({kind: len(getattr(bpy.data, kind)) for kind in kinds})
    return counts


@coarse_clouds()
def images_through_updates(
    scenes: Sequence[Scene], camera: PlacedCamera, wanted: Sequence[RenderSettings]
) -> list[tuple[int, int, int]]:
    """What becomes of Blender's images as one world after the other is shown and rendered.

    Returns for each change of the world how many images of the last render that Cycles made were
    removed before the next render, how many there were before that, and how many are left after.
    """
    backend = BlenderBackend()
    backend.build(scenes[0], ignore)
    backend.render_all([camera], wanted[0], ignore)
    in_cycles = {image.as_pointer() for image in bpy.data.images}
    found = []
    for scene, quality in zip(scenes[1:], wanted[1:], strict=True):
        backend.update(scene)
        present = {image.as_pointer() for image in bpy.data.images}
        backend.render_all([camera], quality, ignore)
        left = {image.as_pointer() for image in bpy.data.images}
        found.append((len(in_cycles - present), len(present), len(left)))
        if quality.quality != DRAFT:
            in_cycles = left
    return found


def lookups_by_level(scene: Scene) -> list[set[tuple[str, str]]]:
    """Which images each level of the ground's textures looks up, and where, as Cycles sees it."""
    BlenderBackend().build(scene, ignore)
    groups = [g for g in bpy.data.node_groups if g.name.startswith("ground_level")]
    return [set(_lookups(level, {})) for level in groups]


def _lookups(tree: Any, inputs: dict[Any, str]) -> Iterator[tuple[str, str]]:
    """Yield each image in a tree and its groups, and the formula of its coordinates."""
    for node in tree.nodes:
        if node.type == "TEX_IMAGE":
            moved = tuple(node.texture_mapping.translation)
            yield node.image.name, f"{moved} {_formula(node.inputs['Vector'], inputs)}"
        elif node.type == "GROUP":
            given = {each.identifier: _formula(each, inputs) for each in node.inputs}
            yield from _lookups(node.node_tree, given)


def _formula(socket: Any, inputs: dict[Any, str]) -> str:
    """Return what a socket is computed from; ``inputs`` are those of its group by identifier."""
    if not socket.is_linked:
        return str(tuple(socket.default_value) if socket.type != "VALUE" else socket.default_value)
    link = socket.links[0]
    node = link.from_node
    if node.type == "GROUP_INPUT":
        return inputs[link.from_socket.identifier]
    name = f"{node.type} {getattr(node, 'operation', '')} {getattr(node, 'image', '')}"
    if node.type == "GROUP":
        name += node.node_tree.name
    parts = ", ".join(_formula(each, inputs) for each in node.inputs if each.enabled)
    return f"{name} {link.from_socket.identifier}({parts})"


def albedos(
    cases: Sequence[tuple[Scene, PlacedCamera]], few: int, many: int
) -> list[dict[str, Any]]:
    """The albedo that few and many samples see in each view, and the ground's without noise.

    All of them see the textures that pictures of few samples have.
    """
    backend = BlenderBackend()
    tone_map = Cycles.denoise_and_tonemap
    given: list[Any] = []

    def kept(
        cycles: Cycles, rendered: Any, wanted: Any, denoising: Any, ground: Any, *more: Any
    ) -> Any:
        given.append((rendered.passes[postprocessing.SEEN_ALBEDO], ground))
        return tone_map(cycles, rendered, wanted, denoising, ground, *more)

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
