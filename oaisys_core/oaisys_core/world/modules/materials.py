"""The module that draws the ground's material: texture sets, their labels and their masks."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from math import radians

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from oaisys_core import randomness
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.terrain.detail import Detail
from oaisys_core.procedural.terrain.displacement import LayerRelief, displace, relief_of_maps
from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.procedural.terrain.masks.cover import is_green, is_snowy
from oaisys_core.procedural.terrain.masks.relief import has_steep_parts
from oaisys_core.procedural.terrain.masks.tone import StageTone
from oaisys_core.procedural.terrain.snow import lay_snow
from oaisys_core.scene import Ground, HeightField
from oaisys_core.scene.photometric_laws import (
    Hapke,
    LommelSeeliger,
    LunarLambert,
    PhotometricLaw,
)
from oaisys_core.scene.surroundings import MacroVariation
from oaisys_core.scene.terrain_material import TerrainMaterial, Variation
from oaisys_core.world.module import Metadata, Module, World, override, require
from oaisys_core.world.modules.layer_weights import land_weights, layer_weights
from oaisys_core.world.modules.layers import (
    LayerLibrary,
    check_layers,
    choose_layers,
    labels_of,
    layer_faults,
)

SNOW_DEPTH_M = 0.5
"""Default depth of snow on grounds with walls of rock."""


class MaterialsMetadata(MaterialsConfig):
    """What a caller can set for a batch, with ``custom={"materials": ...}``.

    Attributes:
        seed: Seed of the material; None for that of the batch.
    """

    seed: int | None = Field(default=None, ge=0, lt=2**63)


class MaterialsModule(Module):
    """Draws which layers a batch has, how they look and where they lie."""

    name = "materials"
    metadata_part = "materials"
    changes_by_itself = False

    def __init__(self, config: MaterialsConfig) -> None:
        try:
            faults = [str(fault) for fault in layer_faults(config, self.name)]
        except InvalidInputError as error:  # of a pool's folder
            faults = [str(error)]
        if faults:
            raise ConfigError("\n".join(faults))
        self._config = MaterialsMetadata.model_validate(config.model_dump())
        self._library = LayerLibrary()

    def setup(self) -> None:
        """Load or make the texture sets of the fixed layers."""
        for layer in self._config.layers:
            self._library.load(layer, self._config)

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values and layers that do not exist."""
        config = override(self._config, metadata, self.metadata_part)
        check_layers(config, f"metadata.{self.metadata_part}")

    def check_sample(self, metadata: Metadata) -> None:
        """Raise on any metadata: the material is drawn once per batch."""
        if metadata:
            raise InvalidInputError(
                "metadata.custom.materials", dict(metadata), "none at a sample step"
            )

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Draw the material of the ground.

        Raises:
            InvalidInputError: A map cannot be used, or the ground cannot be displaced.
        """
        config = override(self._config, metadata, self.metadata_part)
        if config.seed is not None:
            rng = randomness.stream(config.seed, self.name)
        if config.rock_faces is None:
            config = config.model_copy(update={"rock_faces": world.has_rock_walls})
        ground = require(world.ground)
        layers = [
            self._library.draw(layer, config, randomness.child(rng, f"layer/{index}"))
            for index, layer in enumerate(choose_layers(config, rng))
        ]
        green = [is_green(layer.layer.maps) for layer in layers]
        snowy = [is_snowy(layer.layer.maps) for layer in layers]
        configs = [layer.config for layer in layers]
        water_m = None if world.water is None else world.water.level_m
        masks = layer_weights(config, configs, ground, rng, green, snowy, water_m)
        if any(snowy) and not all(snowy):
            _lay_snow(world, config.snow_depth_m, masks[np.array(snowy)].sum(axis=0))
            ground = require(world.ground)
        material = TerrainMaterial(
            layers=tuple(layer.layer for layer in layers),
            masks=masks,
            extent_m=ground.extent_m,
            label_cell_m=config.label_cell_m if config.label_borders == "soft" else None,
            variation=_variation(config),
            projects_sides=_projects_sides(config, ground),
            tone=_tone(config, masks, green, snowy, ground, rng),
            macro=_macro_variation(config, rng),
            wet_bank_m=None
            if world.water is None
            else (world.water.level_m, world.water.level_m + world.water.wet_bank_m),
            is_lambertian=config.reflectance != "rough",
            law=_law(config),
        )
        shown = None
        if config.displacement == "geometry":
            shown = LayerRelief(material, tuple(layer.relief_m for layer in layers))
            _displace(world, shown)
        if world.detail is not None and world.detail.textures:
            world.detail = _with_relief(world.detail, material, shown)
        if len(layers) > 1:
            conditions = [each.when for each in configs]
            land = land_weights(config, material, conditions, world, rng, green, snowy)
            material = replace(material, land=land)
        if (beyond := world.water_beyond()) is not None:
            material = replace(material, wet_extent_m=beyond.extent_m)
        world.material = material
        for layer in layers:
            world.semantic_labels.update(labels_of(layer.config))


def _law(config: MaterialsConfig) -> PhotometricLaw | None:
    if config.reflectance == "lommel_seeliger":
        return LommelSeeliger()
    if config.reflectance == "lunar_lambert":
        return LunarLambert()
    if config.reflectance == "hapke":
        given = config.hapke
        theta_bar_rad = radians(given.theta_bar_deg)
        return Hapke(given.w, given.b, given.c, given.b0, given.h, theta_bar_rad)
    return None


def _variation(config: MaterialsConfig) -> Variation:
    """Return the pattern of a given size; without a size, there is `_tone` instead."""
    if config.variation.scale_m is None:
        return Variation(brightness=0.0)
    return Variation(**config.variation.model_dump())


def _tone(
    config: MaterialsConfig,
    masks: NDArray[np.float32],
    green: Sequence[bool],
    snowy: Sequence[bool],
    ground: Ground,
    rng: np.random.Generator,
) -> StageTone | None:
    variation = config.variation
    if variation.scale_m is not None or not (variation.brightness or variation.tint):
        return None
    strength = Variation(**variation.model_dump())
    seed = int(randomness.child(rng, "tone").integers(2**63))
    return StageTone(ground, masks, tuple(green), tuple(snowy), strength, seed)


def _macro_variation(config: MaterialsConfig, rng: np.random.Generator) -> MacroVariation | None:
    if not config.macro_variation:
        return None
    seed = int(randomness.child(rng, "macro").integers(2**63))
    return MacroPattern(config.macro_variation, seed)


def _projects_sides(config: MaterialsConfig, ground: Ground) -> bool:
    if config.projection == "auto":
        return has_steep_parts(ground)
    return config.projection == "sides"


def _with_relief(detail: Detail, material: TerrainMaterial, shown: LayerRelief | None) -> Detail:
    """Return the refinement with the relief of the ground's textures."""
    reliefs_m = (relief_of_maps(layer.maps) * detail.textures for layer in material.layers)
    return replace(detail, relief=LayerRelief(material, tuple(reliefs_m)), shown=shown)


def _lay_snow(world: World, depth_m: float | None, share: NDArray[np.float32]) -> None:
    """Raise the ground by its snow, of which (M, M) texels have a share."""
    if depth_m is None:
        depth_m = SNOW_DEPTH_M if world.has_rock_walls else 0.0
    if depth_m:
        ground = _height_field(world, "materials.snow_depth_m", depth_m, "0")
        _move_ground(world, lay_snow(ground, share, depth_m))


def _displace(world: World, relief: LayerRelief) -> None:
    ground = _height_field(world, "materials.displacement", "geometry", "bump")
    _move_ground(world, displace(ground, relief))


def _height_field(world: World, field: str, received: object, expected: str) -> HeightField:
    ground = require(world.ground)
    if isinstance(ground, HeightField):
        return ground
    raise InvalidInputError(
        field, received, f"{expected}, because this ground is not a height field"
    )


def _move_ground(world: World, moved: HeightField) -> None:
    world.ground = moved
    digest = hashlib.sha256(world.stage_hash.encode())
    digest.update(np.ascontiguousarray(moved.elevation_m).tobytes())
    world.stage_hash = digest.hexdigest()
