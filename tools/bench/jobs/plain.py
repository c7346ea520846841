"""The plain way, as in the original: one full render by Cycles for each kind of image.

Each has 128 samples per pixel; for labels, materials are replaced by emission. Nothing is kept
between renders, and there is no denoiser.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy
import cv2

from oaisys_core.types import RGB
from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.worlds.demo_views import VIEWS

PLAIN_SAMPLES, QUICK_SAMPLES = 128, 4
PRESETS = ("geometry", "preview", "standard")
CAMERA_STEP_M = 0.15


def against_presets(settings: Settings, say: Say) -> dict[str, Any]:
    """Return seconds of the plain renders of each view, and of each preset at the same views."""
    samples = QUICK_SAMPLES if settings.quick else PLAIN_SAMPLES
    views = VIEWS[: settings.plain_views]
    folder = settings.out / "plain"
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, float]] = []
    presets: dict[str, list[float]] = {name: [] for name in PRESETS}
    with simulation_of(world_config(settings)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        for index, view in enumerate(views):
            say(index / len(views), f"{view.name}: presets")
            for preset in PRESETS:
                poses = [
                    view.pose(observer.heights_m, CAMERA_STEP_M * run)
                    for run in range(settings.runs)
                ]
                presets[preset] += observer.seconds(poses, preset)
            rows.append({})
            for kind in ("rgb_and_depth", "semantic", "instance"):
                say((index + 0.3) / len(views), f"{view.name}: {kind} at {samples} samples")
                pose = view.pose(observer.heights_m)
                render = {"quality": "final", "samples": samples, "denoise": False}
                with _plain(kind):
                    seconds, sample = observer.sample(pose, render, view.environment, [RGB])
                rows[-1][kind] = seconds
                cv2.imwrite(
                    str(folder / f"{view.name}_{kind}.png"), sample.frames[0].data[..., ::-1]
                )
    return {"samples": samples, "views": rows, "presets": presets}


@contextmanager
def _plain(kind: str) -> Iterator[None]:
    """Set Blender up for a render the plain way; restore everything afterwards."""
    bpy.context.scene.render.use_persistent_data = False
    layer = bpy.context.view_layer
    swapped: list[tuple[Any, Any, Any, list[Any]] | None] = []
    if kind == "rgb_and_depth":
        layer.use_pass_z = True
    else:
        by_object = kind == "instance"
        swapped += [_swap(material, by_object=by_object) for material in bpy.data.materials]
    try:
        yield
    finally:
        layer.use_pass_z = False
        for tree, surface, target, added in filter(None, swapped):
            tree.links.new(surface, target)
            for node in added:
                tree.nodes.remove(node)
        bpy.context.scene.render.use_persistent_data = True


def _swap(material: Any, *, by_object: bool) -> tuple[Any, Any, Any, list[Any]] | None:
    """Replace a material's surface by emission of one colour per material, or per object.

    Returns what is needed to undo it: tree, surface socket, its target, and the added nodes.
    """
    tree = material.node_tree
    output = tree.get_output_node("CYCLES") if tree is not None else None
    if output is None or not output.inputs["Surface"].links:
        return None
    surface = output.inputs["Surface"].links[0].from_socket
    noise = tree.nodes.new("ShaderNodeTexWhiteNoise")
    shine = tree.nodes.new("ShaderNodeEmission")
    added = [noise, shine]
    noise.noise_dimensions = "1D"
    noise.inputs["W"].default_value = float(zlib.crc32(material.name.encode()) % 1000)
    if by_object:
        info = tree.nodes.new("ShaderNodeObjectInfo")
        added.append(info)
        tree.links.new(info.outputs["Random"], noise.inputs["W"])
    tree.links.new(noise.outputs["Color"], shine.inputs["Color"])
    tree.links.new(shine.outputs[0], output.inputs["Surface"])
    # Not sampled as a lamp, which would take much longer still.
    material.cycles.emission_sampling = "NONE"
    return tree, surface, output.inputs["Surface"], added
