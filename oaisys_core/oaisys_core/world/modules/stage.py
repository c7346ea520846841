"""The module that draws, reads or reuses the ground of a batch."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.sections.stage import (
    BODY_TOLERANCE,
    ReuseConfig,
    StageConfig,
    StageMeshConfig,
    body_name,
)
from oaisys_core.config.sections.water import WaterConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.meshes.checks import MAX_STEP_M, check_float32_step
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.meshes.loaded import LoadedMesh
from oaisys_core.procedural.terrain.dem import ImportedGround, import_dem
from oaisys_core.procedural.terrain.detail import Detail
from oaisys_core.procedural.terrain.ground_checks import check_surface
from oaisys_core.procedural.terrain.landscapes.eroded import erode_ground
from oaisys_core.procedural.terrain.mesh_ground import MeshGround, mesh_ground
from oaisys_core.procedural.terrain.presets import check_preset, make_ground
from oaisys_core.procedural.terrain.surroundings.kinds import Surroundings
from oaisys_core.procedural.terrain.surroundings.octaves import Shaper
from oaisys_core.procedural.terrain.water.ponds import Water, WaterLook, level_from_share, water_on
from oaisys_core.scene import Ground, HeightField
from oaisys_core.types import merge
from oaisys_core.world.module import Metadata, Module, World, override
from oaisys_core.world.stage_store import SUFFIX, StageRecord, content_hash, load_stage, save_stage

LOG = logging.getLogger(__name__)

SHAPERS: dict[str, Shaper] = {
    "craters": "impacts",
    "crater_field": "impacts",
    "dunes": "wind",
    "slab_dunes": "wind",
}
"""Presets whose land something else than water has shaped."""

SHAPERS_OF_BODIES: dict[str, Shaper] = {"moon": "impacts", "mars": "wind"}
"""The same of bodies, for other presets."""

WALLED = frozenset({"alpine", "canyon", "large_terrain", "mesa", "mountain_1", "mountain_2"})
"""Presets with walls of rock."""


class StageModule(Module):
    """Draws the ground of a batch, reads it from a file, or reuses a stored one.

    The batch metadata ``custom["stage"]`` may override any key of the configuration.
    """

    name = "stage"
    metadata_part = "stage"
    changes_by_itself = False

    def __init__(self, config: StageConfig, lowest_sun_rad: float | None = None) -> None:
        """Make the module.

        Args:
            config: Its section.
            lowest_sun_rad: Lowest elevation of the sun, which hills beyond the stage leave free;
                None for no such limit.

        Raises:
            ConfigError: There is no such preset.
        """
        try:
            check_preset(config.preset)
        except InvalidInputError as error:
            raise ConfigError(str(error)) from error
        self._config = config
        self._lowest_sun_rad = lowest_sun_rad
        self._hash = ""

    def with_config(self, config: StageConfig, lowest_sun_rad: float | None) -> StageModule:
        """Return the module with another configuration, or itself if it has that one."""
        if (config, lowest_sun_rad) == (self._config, self._lowest_sun_rad):
            return self
        module = StageModule(config, lowest_sun_rad)
        module._hash = self._hash  # of a stage that may be kept
        return module

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values and presets that do not exist."""
        config = override(self._config, metadata, self.metadata_part)
        check_preset(config.preset)
        store = self._config.store
        if config.store != store:
            expected = f"{store}, as configured, because a step must not write elsewhere"
            raise InvalidInputError("metadata.stage.store", str(config.store), expected)
        if config.mesh is not None and "mesh" in (metadata or {}):
            # Load the mesh now, so that an invalid one is refused before the world changes.
            load_mesh_ground(config.mesh)

    def check_sample(self, metadata: Metadata) -> None:
        """Raise on any metadata: the ground is drawn once per batch."""
        if metadata:
            raise InvalidInputError("metadata.stage", dict(metadata), "none at a sample step")

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Put a new or a stored ground into the world.

        Raises:
            InvalidInputError: A file cannot be used.
        """
        config = override(self._config, metadata, self.metadata_part)
        world.stage_notes, world.georeference = {}, None
        if config.reuse is not None:
            record = self.record(config.reuse)
            world.ground, world.has_rock_walls = record.ground, record.has_rock_walls
        else:
            world.ground = _new_ground(config, rng, world)
            world.has_rock_walls = config.preset in WALLED and not (config.dem or config.mesh)
        world.stage_hash = content_hash(world.ground)
        world.stage_notes["hash"] = self._hash = world.stage_hash
        world.drawn_ground = world.ground
        world.detail = _detail(config, rng)
        world.water = _water(config.water, world.ground)
        if config.water is not None:
            world.semantic_labels.update(config.water.labels)
        world.surroundings = Surroundings(
            kind=config.surroundings,
            seed=_seed_of(rng),
            body_radius_m=config.body_radius_m,
            lowest_sun_rad=self._lowest_sun_rad,
            shaped_by=_shaper(config),
        )

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the metadata with a reused stage given by its hash, because names may change."""
        reuse = self.reuse(metadata)
        if reuse is None or reuse.name is None:
            return metadata
        return merge(metadata, {"reuse": {"name": self._hash}})

    def reuse(self, metadata: Metadata) -> ReuseConfig | None:
        """Return which stage a batch with this metadata reuses, if any."""
        return override(self._config, metadata, self.metadata_part).reuse

    def record(self, reuse: ReuseConfig) -> StageRecord:
        """Return a stored stage.

        Raises:
            InvalidInputError: There is no stage of that name, or its file is damaged.
        """
        if reuse.file is not None:
            return load_stage(reuse.file)
        path = _path(self._config.store, str(reuse.name))
        if path is None or not path.is_file():
            expected = f"the hash or name of a stage in the store ({self._config.store})"
            raise InvalidInputError("stage.reuse.name", reuse.name, expected)
        return load_stage(path, "stage.reuse.name")

    def keep(self, record: StageRecord, metadata: Metadata) -> None:
        """Store the stage of a batch under its hash, and under its name if it has one.

        Raises:
            InvalidInputError: The store is not writable.
        """
        config = override(self._config, metadata, self.metadata_part)
        path = _path(config.store, record.stage_hash)
        if path is not None and not path.is_file():
            save_stage(path, record)
        named = _path(config.store, config.save_as) if config.save_as else None
        if named is not None:
            save_stage(named, record)


def _path(store: Path | None, name: str) -> Path | None:
    return None if store is None else store / f"{name}{SUFFIX}"


def _new_ground(config: StageConfig, rng: np.random.Generator, world: World) -> Ground:
    """Return a ground that is not kept, and write down in the world what is known about it."""
    notes = world.stage_notes
    if config.mesh is not None:
        mesh = load_mesh_ground(config.mesh)
        if any(mesh.local_origin_m):
            notes["local_origin_m"] = list(mesh.local_origin_m)
        return mesh
    posting_m = None
    if config.dem is not None:
        imported = import_dem(config.dem)
        _check_body(imported, config)
        notes.update(holes=imported.holes, filled_px=imported.filled_px)
        world.georeference = imported.georeference
        ground, posting_m = imported.ground, imported.posting_m
    else:
        ground = _preset_ground(config, rng)
    if config.erosion is None:
        return ground
    kept_m = posting_m if config.erosion.below_posting else None
    return erode_ground(ground, config.erosion, randomness.child(rng, "erosion"), kept_m)


def _preset_ground(config: StageConfig, rng: np.random.Generator) -> HeightField:
    return make_ground(
        config.preset,
        config.extent_m,
        config.resolution_px,
        rng,
        roughness=config.roughness,
        relief_m=config.relief_m,
    )


def _check_body(imported: ImportedGround, config: StageConfig) -> None:
    """Warn if an elevation model is not of the stage's body."""
    radius_m = imported.body_radius_m
    if radius_m is not None and abs(radius_m / config.body_radius_m - 1) > BODY_TOLERANCE:
        LOG.warning(
            "stage.dem.file is of a body with a radius of %.0f m, but stage.body is %s: the land"
            " beyond the stage curves as on the latter, and the sky may be another's",
            radius_m,
            config.body,
        )


def _shaper(config: StageConfig) -> Shaper:
    """Return what shaped the land around a stage: as the preset, or as usual on the body."""
    if config.dem is None and config.mesh is None and config.preset in SHAPERS:
        return SHAPERS[config.preset]
    return SHAPERS_OF_BODIES.get(body_name(config.body) or "", "water")


def load_mesh_ground(config: StageMeshConfig) -> MeshGround:
    """Return the ground that a mesh in a file is.

    Raises:
        InvalidInputError: See `load_stage_mesh`, `mesh_ground` and `check_surface`.
    """
    mesh = load_stage_mesh(config)
    ground = mesh_ground(mesh, config.scale, config.up, config.position_m)
    check_surface(ground, config.file, "stage.mesh.file")
    return ground


def load_stage_mesh(config: StageMeshConfig) -> LoadedMesh:
    """Return the mesh of a ground as it is in its file.

    Raises:
        InvalidInputError: See `load_mesh`; or its numbers are too coarse for where it lies.
    """
    mesh = load_mesh(config.file, config.object, "stage.mesh.file")
    most = MAX_STEP_M / config.scale
    check_float32_step(mesh.float32, most, config.file, "stage.mesh.file")
    return mesh


def _water(config: WaterConfig | None, ground: Ground) -> Water | None:
    if config is None:
        return None
    level_m = config.level_m
    if level_m is None:
        level_m = level_from_share(ground, config.level_share or 0.0)
    look = WaterLook(config.clarity_m, config.color_srgb, config.waves)
    return water_on(ground, level_m, config.semantic_ids, look, config.wet_bank_m)


def _detail(config: StageConfig, rng: np.random.Generator) -> Detail | None:
    if config.detail is None:
        return None
    return Detail(seed=_seed_of(rng), **config.detail.model_dump())


def _seed_of(rng: np.random.Generator) -> int:
    """Return a seed that does not depend on what has been drawn."""
    seeds = rng.bit_generator.seed_seq
    words = seeds.generate_state(1, np.uint64)
    return int(words[0] >> np.uint64(1))
