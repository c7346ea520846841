"""The weights of the ground's layers at a point, from images of their masks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.land import land_place, land_share
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket, node_group
from oaisys_core.scene.terrain_material import TerrainMaterial

CHANNELS = 4
"""Masks per image."""


class LayerWeights:
    """The weights of a material's layers, as nodes."""

    def __init__(
        self, material: TerrainMaterial, masks: Sequence[Any], land_masks: Sequence[Any]
    ) -> None:
        """Take over images of masks.

        Args:
            material: A material of several layers.
            masks: Images of the weights on the stage.
            land_masks: Images of those on the land around it; none for the stage's own material.
        """
        self._material = material
        counts = [
            min(CHANNELS, len(material.layers) - CHANNELS * number) for number in range(len(masks))
        ]
        of_land = land_masks or [None] * len(masks)
        self._groups = [
            node_group(
                "layer_weights",
                partial(self._weights, count, *images),
                inputs=("Vector",),
                outputs=("Float",) * count,
            )
            for count, *images in zip(counts, masks, of_land, strict=True)
        ]

    def sockets(self, tree: NodeTree, number: int, nudge: Socket) -> Sequence[Socket]:
        """Return the weights of up to `CHANNELS` layers at the position, moved by a nudge."""
        group = tree.add("Group", {0: nudge}, node_tree=self._groups[number])
        outputs: Sequence[Socket] = group.outputs
        return outputs

    def _weights(
        self, count: int, mask: Any, land_mask: Any, tree: NodeTree, nudge: Socket
    ) -> list[Socket]:
        """Return the weights in the channels of an image of masks."""
        position = tree.vector("ADD", tree.add("NewGeometry").outputs["Position"], nudge)
        place = mask_place(tree, self._material, position)
        weights = _channels(tree, mask, count, place, "MIRROR")
        land = self._material.land
        if land is None or land_mask is None:
            return weights
        place = land_place(tree, land, position)
        of_land = _channels(tree, land_mask, count, place, "REPEAT")
        share = land_share(tree, land, position)
        return [
            tree.math("MULTIPLY_ADD", tree.math("SUBTRACT", far, near), share, near)
            for near, far in zip(weights, of_land, strict=True)
        ]


def mask_images(masks: NDArray[np.float32], name: str) -> list[Any]:
    """Return images of (L, R, C) masks, `CHANNELS` to each."""
    images = []
    for first in range(0, len(masks), CHANNELS):
        part = masks[first : first + CHANNELS]
        pixels = np.zeros((*masks.shape[1:], CHANNELS), dtype=np.float32)
        # The first mask is in alpha, which needs no node to separate.
        pixels[..., -1] = part[0]
        pixels[..., : len(part) - 1] = np.moveaxis(part[1:], 0, -1)
        images.append(new_image(f"{name}_{first}", pixels, is_float=False, is_color=False))
    return images


def mask_place(tree: NodeTree, material: TerrainMaterial, position: Socket) -> Socket:
    """Return the place in images of the whole ground at a position."""
    x0, y0, x1, y1 = material.extent_m
    size_inverse = (1.0 / (x1 - x0), 1.0 / (y1 - y0), 0.0)
    start = (-x0 / (x1 - x0), -y0 / (y1 - y0), 0.0)
    return tree.vector("MULTIPLY_ADD", position, size_inverse, start)


def _channels(
    tree: NodeTree, image: Any, count: int, place: Socket, extension: str
) -> list[Socket]:
    """Return the first masks in an image, see `mask_images`."""
    texel = tree.add("TexImage", {"Vector": place}, image=image, extension=extension).outputs
    return [texel["Alpha"], *(tree.component(texel["Color"], each) for each in range(count - 1))]
