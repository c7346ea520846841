"""The ground's material: texture sets, their labels and where each of them lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oaisys_core.config.materials import LayerConfig, MaterialsConfig
from oaisys_core.module import Metadata, Module, World, drawn
from oaisys_core.scene import PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.terrain.masks import blend_masks
from oaisys_core.textures import default_cache_dir, load_texture_folder, texture_set

FOLDER_TILE_M = 2.0
"""Edge length of a tile of a user's texture folder that does not say its own."""


class MaterialsModule(Module):
    """Loads the layers once and draws new blend masks for each batch."""

    name = "materials"
    metadata_part = "materials"

    def __init__(self, config: MaterialsConfig) -> None:
        self._config = config
        self._layers: tuple[TerrainLayer, ...] = ()

    def setup(self) -> None:
        """Load or make the texture sets."""
        self._layers = tuple(
            TerrainLayer(layer.label, layer.semantic_ids, self._maps(layer))
            for layer in self._config.layers
        )

    def _maps(self, layer: LayerConfig) -> PbrMaps:
        if layer.folder is not None:
            tile_m = layer.tile_m[0] if layer.tile_m else FOLDER_TILE_M
            return load_texture_folder(layer.folder, tile_m, size_px=None)
        config = self._config
        maps = texture_set(
            layer.texture, config.texture_size_px, config.texture_seed, default_cache_dir()
        )
        return maps if layer.tile_m is None else replace(maps, tile_m=layer.tile_m[0])

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Lay the layers over the ground."""
        ground = drawn(world.ground)
        extent_m = ground.extent_m
        mask = self._config.mask
        masks = blend_masks(
            len(self._layers),
            extent_m[2] - extent_m[0],
            mask.size_px,
            rng,
            scale_m=mask.scale_m,
            sharpness=mask.sharpness,
        )
        world.material = TerrainMaterial(self._layers, masks, extent_m)
        for layer in self._config.layers:
            world.semantic_labels.update(layer.labels)
