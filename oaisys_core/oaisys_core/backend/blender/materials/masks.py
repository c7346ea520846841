"""Where each layer of the ground lies, in Blender: images of weights, and what they tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from oaisys_core.backend.blender.materials.images import new_image
from oaisys_core.backend.blender.materials.nodes import NodeTree, Socket
from oaisys_core.world.terrain_material import TerrainMaterial

CHANNELS = 4
"""Masks that one image holds."""

NOTHING = 1 / 256
"""Share of a layer up to which none of it shows, and beyond which, of the rest, nothing else does:
what the eye cannot see is not to be evaluated."""


def mask_images(material: TerrainMaterial) -> list[Any]:
    """Return images of the weights of all layers but the first, `CHANNELS` to each."""
    masks = material.masks[1:]
    images = []
    for first in range(0, len(masks), CHANNELS):
        part = masks[first : first + CHANNELS]
        pixels = np.zeros((*masks.shape[1:], CHANNELS), dtype=np.float32)
        # Alpha comes first: it is a scalar already.
        pixels[..., -1] = part[0]
        pixels[..., : len(part) - 1] = np.moveaxis(part[1:], 0, -1)
        images.append(new_image(f"masks_{first}", pixels, is_float=True, is_color=False))
    return images


def layer_shares(
    tree: NodeTree, material: TerrainMaterial, masks: Sequence[Any], position: Socket
) -> list[Socket]:
    """Return, for each layer but the first, its share at ``position`` of it and those before it."""
    x0, y0, x1, y1 = material.extent_m
    size_inverse = (1.0 / (x1 - x0), 1.0 / (y1 - y0), 0.0)
    start = (-x0 / (x1 - x0), -y0 / (y1 - y0), 0.0)
    left = len(material.layers) - 1
    weights: list[Socket] = []
    for image in masks:
        place = tree.vector("MULTIPLY_ADD", position, size_inverse, start)
        texel = tree.add("TexImage", {"Vector": place}, image=image, extension="MIRROR")
        weights.append(texel.outputs["Alpha"])
        if left > 1:
            channels = tree.add("SeparateColor", {"Color": texel.outputs["Color"]})
            weights.extend(channels.outputs[: min(left, CHANNELS) - 1])
        left -= CHANNELS
    shares: list[Socket] = []
    rest: Socket = 1.0
    for weight in reversed(weights):
        share = tree.math("DIVIDE", weight, rest) if shares else weight
        rest = tree.math("SUBTRACT", rest, weight)
        gain = 1 / (1 - 2 * NOTHING)
        shares.append(tree.clamped("MULTIPLY_ADD", share, gain, -NOTHING * gain))
    return shares[::-1]
