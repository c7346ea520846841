"""The ground's material: layers of texture, mixed by their masks.

Each level of the textures, each plane that they are projected onto, and each layer is a surface of
its own, because Cycles evaluates only those surfaces of a mixture whose weight is not 0.

Cycles keeps numbers that are still needed on a stack of 255; where these do not suffice, it says so
on standard error and renders black. So no part of the material may leave anything on it that
another layer needs: see `ground_level`. With 16 layers and everything else on, half of it is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.procedural.contact_map import ContactMap
from oaisys_core.render.blender.compat import node_tree_of
from oaisys_core.render.blender.materials.contact import contact_image, with_rims
from oaisys_core.render.blender.materials.ground.layer import MaterialLevel, MaterialTables
from oaisys_core.render.blender.materials.ground.layer_weights import (
    LayerWeights,
    mask_images,
    mask_place,
)
from oaisys_core.render.blender.materials.ground.level import LevelNodes
from oaisys_core.render.blender.materials.haze import through_haze
from oaisys_core.render.blender.materials.images import BYTE, ImageStore, new_image
from oaisys_core.render.blender.materials.land import land_relief
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket, in_group
from oaisys_core.render.blender.materials.photometric import by_law
from oaisys_core.render.blender.materials.surfaces import (
    GROUND,
    new_material,
    show,
    without_detail,
)
from oaisys_core.render.blender.materials.water import wet
from oaisys_core.render.shading.ground_contact import mean_colors
from oaisys_core.render.shading.looks import footprints_m, is_glossy, varies
from oaisys_core.scene.surroundings import LandDetail
from oaisys_core.scene.terrain_material import TerrainMaterial

MEAN_PX = 256
"""Edge length of the image of the ground that indirect light sees."""

NUDGE_M = 1e-6
"""See `NUDGE`, for the colour of fines."""


class GroundMaterials:
    """The materials of the ground on a stage and around it, in which levels and layers are groups.

    Attributes:
        stage: The material on the stage.
    """

    def __init__(
        self, material: TerrainMaterial, images: ImageStore, has_tracks: bool = False
    ) -> None:
        """Make the stage's material, which shows tracks if ``has_tracks``."""
        self._material, self._images = material, images
        self._has_tracks = has_tracks
        self._rims: Any = None
        self._masks = mask_images(material.masks, "masks")
        tables = MaterialTables(
            macro=None
            if material.macro is None
            else _factor_image("macro_variation", material.macro.share),
            tone=None if material.tone is None else _factor_image("tone", material.tone.pixels),
            tilings={},
            glossy={
                id(layer.maps): is_glossy(layer.maps) and not material.is_lambertian
                for layer in material.layers
            },
            varies=varies(material),
        )
        self._bounds_m = footprints_m(material)
        self._levels = [
            MaterialLevel(material, images, tables, finer, footprint_m)
            for finer, footprint_m in enumerate(self._bounds_m)
        ]
        self._groups: dict[tuple[Any, ...], Any] = {}
        self.stage = self._make("ground", ())

    def show_contact(self, contact: ContactMap | None) -> None:
        """Show the fines at the feet of things; None shows none."""
        self._rims.image = contact_image(contact)

    def around_stage(self, detail: LandDetail | None) -> Any:
        """Return the material of the ground around the stage, made now if it is another one."""
        land = self._material.land
        if land is None and detail is None:
            return self.stage
        masks = () if land is None else mask_images(land.weights, "land_masks")
        return self._make("land", masks, detail)

    def _make(self, name: str, land_masks: Sequence[Any], detail: LandDetail | None = None) -> Any:
        result = new_material(name)
        result.pass_index = GROUND
        tree = NodeTree(node_tree_of(result))
        weights = None
        if len(self._material.layers) > 1:
            weights = LayerWeights(self._material, self._masks, land_masks)
        surfaces = [
            in_group(tree, f"{name}_level", partial(self._level_surface, level, weights))
            for level in self._levels
        ]
        _, airlight = through_haze(tree, (0.0, 0.0, 0.0, 1.0))
        surface = tree.by_footprint(self._bounds_m[1:], surfaces)
        # An image of the whole ground has no meaningful mean colour.
        has_mean = not any(layer.label_image is not None for layer in self._material.layers)
        if self._rims is None:
            fines = self._fines_color(tree) if has_mean else None
            surface, self._rims = with_rims(
                tree, surface, fines, self._material.extent_m, self._has_tracks
            )
        if has_mean:
            layers = self._material.layers
            roughness = float(np.mean([each.maps.roughness.mean() for each in layers])) / 255
            if self._material.is_lambertian:
                roughness = 0.0
            inputs: dict[str | int, Any] = {
                "Color": self._mean_color(tree),
                "Roughness": roughness,
            }
            mean = tree.add("BsdfDiffuse", inputs).outputs[0]
            surface = without_detail(tree, surface, mean)
        extent_m = self._material.wet_extent_m if land_masks else None
        if self._material.wet_bank_m is not None and (extent_m or not land_masks):
            surface = wet(tree, surface, self._material.wet_bank_m, extent_m)
        height_m = None
        if detail is not None:
            height_m = land_relief(tree, detail, self._material.extent_m)
        show(tree, surface, airlight, height_m)
        return result

    def _level_surface(
        self, level: MaterialLevel, weights: LayerWeights | None, tree: NodeTree
    ) -> Socket:
        return LevelNodes(tree, level, self._groups, weights).surface()

    def _fines_color(self, tree: NodeTree) -> Socket:
        color = self._mean_color(tree, NUDGE_M)
        if self._material.law is None:
            return color
        color = color[:3] if isinstance(color, tuple) else color
        return by_law(tree, color, tree.add("NewGeometry").outputs["Normal"])

    def _mean_color(self, tree: NodeTree, nudge_m: float = 0.0) -> Socket:
        """Return the mean colour of the layers, at a place that may be nudged: `NUDGE`."""
        if len(self._material.layers) == 1:
            return (*mean_colors(self._material, self._images)[0], 1.0)
        position = tree.add("NewGeometry").outputs["Position"]
        if nudge_m:
            position = tree.vector("ADD", position, (nudge_m, 0.0, 0.0))
        inputs: dict[str | int, Any] = {"Vector": mask_place(tree, self._material, position)}
        texel = tree.add(
            "TexImage", inputs, image=self._mean, extension="MIRROR", interpolation="Closest"
        )
        return texel.outputs["Color"]

    @cached_property
    def _mean(self) -> Any:
        return mean_image(self._material, self._images)


def _factor_image(name: str, share: NDArray[np.uint8]) -> Any:
    """Return an image of (rows, columns, 3) bytes that stand for factors."""
    pixels = np.ones((*share.shape[:2], 4), np.float32)
    np.multiply(share, BYTE, out=pixels[..., :3])
    return new_image(name, pixels, is_float=False, is_color=False)


def mean_image(material: TerrainMaterial, images: ImageStore) -> Any:
    """Return a small image of the mean colour of the layers, mixed by their masks.

    Light that comes from the ground hits it anywhere, so the image must fit into a core's cache.
    """
    size = min(MEAN_PX, material.masks.shape[1])
    masks = [cv2.resize(m, (size, size), interpolation=cv2.INTER_AREA) for m in material.masks]
    pixels = np.ones((size, size, 4), np.float32)
    means = mean_colors(material, images)
    np.multiply(encode_srgb(np.stack(masks, axis=-1) @ means), BYTE, out=pixels[..., :3])
    return new_image("ground_mean", pixels, is_float=False, is_color=True)
