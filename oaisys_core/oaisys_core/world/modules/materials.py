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
from oaisys_core.config.sections.layer_conditions import ConditionConfig
from oaisys_core.config.sections.layers import LayerConfig
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.terrain.detail import Detail
from oaisys_core.procedural.terrain.displacement import LayerRelief, displace, relief_of_maps
from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.procedural.terrain.masks.patches import (
    LayerNoise,
    blend_masks,
    border_softness,
    layer_masks,
)
from oaisys_core.procedural.terrain.masks.relief import (
    RELIEF_PX,
    exposure,
    has_steep_parts,
    relief_of,
)
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks, farthest_m
from oaisys_core.procedural.terrain.surroundings.land_relief import ReliefAround
from oaisys_core.scene import Ground, HeightField
from oaisys_core.scene.photometric_laws import (
    Hapke,
    LommelSeeliger,
    LunarLambert,
    PhotometricLaw,
)
from oaisys_core.scene.surroundings import LandMasks, MacroVariation
from oaisys_core.scene.terrain_material import TerrainMaterial, Variation
from oaisys_core.world.module import Metadata, Module, World, override, require
from oaisys_core.world.modules.layer_gates import gate_of_level, layer_gates
from oaisys_core.world.modules.layers import (
    LayerLibrary,
    check_layers,
    choose_layers,
    exposure_of,
    labels_of,
    layer_faults,
)

NO_SHARE = 1.0
"""Share of a layer without one, if another layer has a share."""


RELIEF_STRENGTH = 2.0
"""Change of a patch's score, in standard deviations of patches, where the ground is one standard
deviation more exposed and the layer lies on exposed ground only."""

NOISE_SOFTNESS = 0.07
"""Width of the borders on the land around a stage whose layers lie by the method ``noise``."""


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
        ground = require(world.ground)
        layers = [
            self._library.draw(layer, config, randomness.child(rng, f"layer/{index}"))
            for index, layer in enumerate(choose_layers(config, rng))
        ]
        material = TerrainMaterial(
            layers=tuple(layer.layer for layer in layers),
            masks=_masks(config, [layer.config for layer in layers], ground, rng),
            extent_m=ground.extent_m,
            label_cell_m=config.label_cell_m if config.label_borders == "soft" else None,
            variation=Variation(**config.variation.model_dump()),
            projects_sides=_projects_sides(config, ground),
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
            conditions = [layer.config.when for layer in layers]
            material = replace(material, land=_land_masks(config, material, conditions, world, rng))
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


def _masks(
    config: MaterialsConfig,
    layers: Sequence[LayerConfig],
    ground: Ground,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    mask = config.mask
    size_m = (
        ground.extent_m[2] - ground.extent_m[0],
        ground.extent_m[3] - ground.extent_m[1],
    )
    shares = None
    if any(layer.share is not None for layer in layers):
        shares = [layer.share or NO_SHARE for layer in layers]
    gates = layer_gates([layer.when for layer in layers], ground, mask.size_px)
    if mask.method == "patches":
        return blend_masks(
            len(layers),
            size_m[0],
            mask.size_px,
            rng,
            scale_m=mask.scale_m,
            sharpness=mask.sharpness,
            shares=shares,
            gates=gates,
            preferences=_preferences(config, layers, ground),
        )
    rngs = [randomness.child(rng, f"noise/{index}") for index in range(len(layers))]
    noise = mask.noise
    ranges = (noise.scale, noise.detail, noise.roughness, noise.distortion)
    noises = [LayerNoise(*(float(each.uniform(*bounds)) for bounds in ranges)) for each in rngs]
    return layer_masks(
        noises, size_m, mask.size_px, rngs, noise.borders, shares=shares, gates=gates
    )


def _preferences(
    config: MaterialsConfig, layers: Sequence[LayerConfig], ground: Ground
) -> NDArray[np.float32] | None:
    """Return (L, M, M) by how much the ground's forms favour each layer; None if they do not."""
    import cv2

    mask = config.mask
    exposures = np.array([exposure_of(layer) for layer in layers], np.float32)
    if not mask.relief or not np.ptp(exposures):
        return None
    texel_m = (ground.extent_m[2] - ground.extent_m[0]) / RELIEF_PX
    exposed = exposure(relief_of(ground, RELIEF_PX), texel_m, mask.scale_m)
    size = (mask.size_px, mask.size_px)
    exposed = np.asarray(cv2.resize(exposed, size, interpolation=cv2.INTER_CUBIC))
    return np.asarray(
        np.float32(RELIEF_STRENGTH * mask.relief) * exposures[:, None, None] * exposed
    )


def _macro_variation(config: MaterialsConfig, rng: np.random.Generator) -> MacroVariation | None:
    if not config.macro_variation:
        return None
    return MacroPattern(config.macro_variation, _seed(rng, "macro"))


def _land_masks(
    config: MaterialsConfig,
    material: TerrainMaterial,
    conditions: Sequence[ConditionConfig | None],
    world: World,
    rng: np.random.Generator,
) -> LandMasks | None:
    """Return the masks of the ground around the stage; None if the stage's go on mirrored.

    On land, layers have the same shares as on the stage. A plain around a stage whose layers have
    conditions has those of them that lie on level ground.
    """
    x0, y0, x1, y1 = material.extent_m
    shares = material.masks.mean(axis=(1, 2), dtype=np.float64)
    relief = None
    if world.is_in_land:
        ground = require(world.ground)
        world.far_ground = world.surroundings.around(ground, world.far_ground)
        reach_m = farthest_m(min(x1 - x0, y1 - y0) / 2)
        relief = ReliefAround(world.far_ground, ground, material.masks, reach_m)
    else:
        shares *= [1.0 if when is None else gate_of_level(when) for when in conditions]
        if not any(conditions) or not shares.any():
            return None
    mask = config.mask
    patch_m, softness = mask.scale_m, border_softness(mask.sharpness)
    if mask.method == "noise":
        patch_m = max(x1 - x0, y1 - y0) / float(np.mean(mask.noise.scale))
        softness = NOISE_SOFTNESS
    return PatchyLandMasks(
        extent_m=material.extent_m,
        shares=tuple(shares.tolist()),
        patch_m=patch_m,
        softness=softness,
        seed=_seed(rng, "land"),
        relief=relief,
    )


def _seed(rng: np.random.Generator, name: str) -> int:
    return int(randomness.child(rng, name).integers(2**63))


def _projects_sides(config: MaterialsConfig, ground: Ground) -> bool:
    if config.projection == "auto":
        return has_steep_parts(ground)
    return config.projection == "sides"


def _with_relief(detail: Detail, material: TerrainMaterial, shown: LayerRelief | None) -> Detail:
    """Return the refinement with the relief of the ground's textures."""
    reliefs_m = (relief_of_maps(layer.maps) * detail.textures for layer in material.layers)
    return replace(detail, relief=LayerRelief(material, tuple(reliefs_m)), shown=shown)


def _displace(world: World, relief: LayerRelief) -> None:
    ground = require(world.ground)
    if not isinstance(ground, HeightField):
        raise InvalidInputError(
            "materials.displacement", "geometry", "bump, because this ground is not a height field"
        )
    moved = displace(ground, relief)
    world.ground = moved
    digest = hashlib.sha256(world.stage_hash.encode())
    digest.update(np.ascontiguousarray(moved.elevation_m).tobytes())
    world.stage_hash = digest.hexdigest()
