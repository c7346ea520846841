"""Depth and labels from passes of Cycles, as a reference for the faster ray casting.

Tests and the bench compare `oaisys_core.raycast.surface` with it. Cycles renders the same objects
as for colour, under a material that only writes the id of each object and the weights of the
ground's layers, which Cycles interpolates itself. A minimal pixel filter keeps each ray within
0.005 px of its pixel's centre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.geometry import pixel_rays
from oaisys_core.render.blender.camera import place, set_intrinsics, set_lens
from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.cycles_render import render_scene
from oaisys_core.render.blender.materials.land import land_place, land_share
from oaisys_core.render.blender.materials.nodes import NodeTree
from oaisys_core.render.blender.objects.instances import ID, ids_from_floats
from oaisys_core.render.blender.postprocessing import BACKGROUND_M
from oaisys_core.scene import PlacedCamera, Scene, TerrainMaterial, id_of_level
from oaisys_core.scene.terrain_material import grain_numbers
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0, FloatArray, semantic_level

FILTER_WIDTH_PX = 0.01
"""Least width that Blender allows."""

PER_IMAGE = 3
"""Weights per colour image."""


def reference_images(
    scene: Scene, camera: PlacedCamera, modalities: Sequence[str] = (DEPTH, SEMANTIC_0, INSTANCE)
) -> dict[str, NDArray[Any]]:
    """Return (H, W) images of the scene in Blender as Cycles sees it, by modality.

    Spheres and boxes are tessellated. Cycles' data kept between colour renders are lost, so that
    the next sample takes as long as the first.

    Args:
        scene: The scene that the backend was last given.
        camera: Without distortion.
        modalities: Any of depth, instance and the levels of semantic.

    Raises:
        RenderError: The camera has distortion, or Blender failed.
    """
    if not camera.intrinsics.is_rectilinear:
        raise RenderError(f"{camera.name}: there is no reference for distorted images")
    passes = _passes(scene, camera)
    depth_m = passes["Depth"][..., 0].copy()
    depth_m[depth_m > BACKGROUND_M] = np.inf
    instance_ids = ids_from_floats(passes[ID][..., :2])
    images: dict[str, NDArray[Any]] = {}
    for modality in modalities:
        level = semantic_level(modality)
        if level is not None:
            images[modality] = _labels(scene, camera, passes, instance_ids, level)
        else:
            images[modality] = {DEPTH: depth_m, INSTANCE: instance_ids}[modality]
    return images


def _passes(scene: Scene, camera: PlacedCamera) -> dict[str, NDArray[np.float32]]:
    """Return Cycles' passes, including ids and weights, by name."""
    blender, layer = bpy.context.scene, bpy.context.view_layer
    names = [ID, *_weight_names(scene.material)]
    material, images = _material(scene.material)
    place(blender.camera, camera.T_map_camera)
    set_intrinsics(blender.camera, camera.intrinsics)
    set_lens(blender.camera, None)
    settings = {"samples": 1, "seed": 0, "use_denoising": False, "max_bounces": 0}
    aovs = [layer.aovs.add() for _ in names]
    for aov, name in zip(aovs, names, strict=True):
        aov.name, aov.type = name, "COLOR"
    pixel_filter = {"pixel_filter_type": "BLACKMAN_HARRIS", "filter_width": FILTER_WIDTH_PX}
    shown = {"use_pass_z": True, "use_pass_position": True, "material_override": material}
    changes: list[tuple[Any, dict[str, Any]]] = [
        (blender.render, {"use_persistent_data": False}),
        (blender.cycles, {**settings, **pixel_filter}),
        (layer, shown),
    ]
    try:
        with ExitStack() as stack:
            for owner, values in changes:
                stack.enter_context(_temporarily(owner, values))
            return render_scene(settings).passes
    finally:
        for aov in aovs:
            layer.aovs.remove(aov)
        bpy.data.materials.remove(material)
        bpy.data.batch_remove(images)


@contextmanager
def _temporarily(owner: Any, values: dict[str, Any]) -> Iterator[None]:
    """Set properties of a Blender object for the duration of a block."""
    before = {name: getattr(owner, name) for name in values}
    for name, value in values.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(owner, name, value)


def _material(ground: TerrainMaterial) -> tuple[Any, list[Any]]:
    """Return a material that writes ids and weights, and the images it reads."""
    material = bpy.data.materials.new("reference")
    nodes = node_tree_of(material)
    tree = NodeTree(nodes)
    tree.add("OutputMaterial", {"Surface": tree.add("BsdfDiffuse").outputs[0]})
    number = tree.add("Attribute", attribute_type="INSTANCER", attribute_name=ID)
    tree.add("OutputAOV", {"Color": number.outputs["Vector"]}, aov_name=ID)
    x0, y0, x1, y1 = ground.extent_m
    position = tree.add("NewGeometry").outputs["Position"]
    at = tree.vector("SUBTRACT", position, (x0, y0, 0.0))
    uv = tree.vector("MULTIPLY", at, (1 / (x1 - x0), 1 / (y1 - y0), 0.0))
    images = []
    for index, name in enumerate(_weight_names(ground)):
        part = slice(PER_IMAGE * index, PER_IMAGE * (index + 1))
        images.append(_image(ground.masks[part]))
        texture = tree.add("TexImage", {"Vector": uv}, image=images[-1], extension="MIRROR")
        weights = texture.outputs["Color"]
        if ground.land is not None:
            images.append(_image(ground.land.weights[part]))
            place = land_place(tree, ground.land, position)
            far = tree.add("TexImage", {"Vector": place}, image=images[-1]).outputs["Color"]
            change = tree.vector("SUBTRACT", far, weights)
            share = land_share(tree, ground.land, position)
            weights = tree.vector("MULTIPLY_ADD", change, share, weights)
        tree.add("OutputAOV", {"Color": weights}, aov_name=name)
    return material, images


def _weight_names(ground: TerrainMaterial) -> list[str]:
    return [f"weights_{first}" for first in range(0, len(ground.layers), PER_IMAGE)]


def _image(masks: NDArray[np.float32]) -> Any:
    """Return a float image of up to three (rows, columns) masks."""
    rows, columns = masks.shape[1:]
    image = bpy.data.images.new("masks", columns, rows, float_buffer=True, is_data=True)
    pixels = np.zeros((rows, columns, 4), np.float32)
    pixels[..., : len(masks)] = np.moveaxis(masks, 0, -1)
    pixels[..., 3] = 1.0
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def _labels(
    scene: Scene,
    camera: PlacedCamera,
    passes: dict[str, NDArray[np.float32]],
    instance_ids: NDArray[np.uint32],
    level: int,
) -> NDArray[np.uint16]:
    """Return the (H, W) semantic ids of objects by id, of the ground by weights, and of the sky."""
    labels = np.zeros(instance_ids.shape, np.uint16)
    seen = passes["Depth"][..., 0] <= BACKGROUND_M
    for placement in scene.placements:
        own = np.isin(instance_ids, placement.instance_ids)
        labels[own] = id_of_level(placement.semantic_ids, level)
    for primitive in scene.primitives:
        own = instance_ids == primitive.instance_id
        labels[own] = id_of_level(primitive.semantic_ids, level)
    ground = seen & (instance_ids == 0)
    names = _weight_names(scene.material)
    weights = np.concatenate([passes[name][ground][:, :PER_IMAGE] for name in names], axis=1)
    xy_m = passes["Position"][ground][:, :2].astype(np.float64)
    layers = scene.material.layers
    labels[ground] = _ground_labels(scene.material, weights[:, : len(layers)], xy_m, level)
    directions = pixel_rays(camera.intrinsics) @ camera.T_map_camera[:3, :3].T
    labels[~seen] = scene.sky.semantic_ids_at(directions[~seen], level)
    return labels


def _ground_labels(
    material: TerrainMaterial, weights: NDArray[np.float32], xy_m: FloatArray, level: int
) -> NDArray[np.uint16]:
    """Return the (N,) semantic ids of (N, L) weights that Cycles found at (N, 2) points."""
    chosen = weights.argmax(axis=1)
    if material.label_cell_m is not None:
        share = np.cumsum(weights, axis=1, dtype=np.float64)
        pick = grain_numbers(xy_m, material.label_cell_m) * share[:, -1]
        chosen = (share[:, :-1] <= pick[:, None]).sum(axis=1)
    labels = np.zeros(len(xy_m), np.uint16)
    for index, layer in enumerate(material.layers):
        here = chosen == index
        labels[here] = layer.ids_at(xy_m[here], level)
    return labels
