"""All modules of a simulation; each gets its part of the metadata and its own random stream."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from oaisys_core import randomness
from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError, did_you_mean
from oaisys_core.procedural.environment.low_sun import lowest_sun_rad
from oaisys_core.types import OWN_PARTS, ModuleMetadata, Progress, ProgressCallback
from oaisys_core.world.batch import Batch, BatchSeeds, Snapshot
from oaisys_core.world.extension_modules import ExtensionModule, make_modules
from oaisys_core.world.module import Module
from oaisys_core.world.modules import (
    AssetsModule,
    EnvironmentModule,
    MaterialsModule,
    RenderModule,
    SensorsModule,
    StageModule,
)
from oaisys_core.world.reuse import STAGE_MODULES, same_stage

DRAW_SHARE = 0.5
"""Share of a batch's progress that drawing takes, before the backend builds the scene."""


@dataclass(frozen=True)
class ModuleSet:
    """The modules, in the order in which they draw.

    Attributes:
        config: What they were made from.
        stage, assets, sensors: The modules in `all` that have further methods.
    """

    config: SimulationConfig

    stage: StageModule
    assets: AssetsModule
    sensors: SensorsModule
    all: tuple[Module, ...]

    @classmethod
    def of(cls, config: SimulationConfig) -> ModuleSet:
        """Make the modules of a configuration, without setting them up.

        Raises:
            ConfigError: The configuration names something that does not exist.
        """
        stage = StageModule(config.stage, lowest_sun_rad(config.environment, config.stage.body))
        sensors = SensorsModule(config.sensors)
        assets = AssetsModule(config.assets, *_rock_textures(config))
        modules: tuple[Module, ...] = (
            stage,
            MaterialsModule(config.materials),
            assets,
            EnvironmentModule(config.environment),
            sensors,
            RenderModule(config.render, config.sensors.modalities),
            *make_modules(config.extensions),
        )
        return cls(config, stage, assets, sensors, modules)

    def for_world(self, config: SimulationConfig) -> ModuleSet:
        """Return the modules of a world whose configuration was drawn, set up.

        A module whose configuration is the same is kept, with its state.

        Raises:
            ConfigError: The configuration names something that does not exist.
        """
        before, now = self.config, config
        assets, sensors = self.assets, self.sensors
        _, materials, _, environment, _, *others = self.all
        stage = self.stage.with_config(now.stage, lowest_sun_rad(now.environment, now.stage.body))
        if now.materials != before.materials:
            materials = MaterialsModule(now.materials)
            materials.setup()
        if (now.assets, _rock_textures(now)) != (before.assets, _rock_textures(before)):
            assets = AssetsModule(now.assets, *_rock_textures(now))
            assets.setup()
        if now.environment != before.environment:
            environment = EnvironmentModule(now.environment)
            environment.setup()
        if now.sensors != before.sensors:
            sensors = SensorsModule(now.sensors)
        modules = (stage, materials, assets, environment, sensors, *others)
        return ModuleSet(config, stage, assets, sensors, modules)

    def setup(self) -> None:
        """Set up all modules."""
        for module in self.all:
            module.setup()

    def check(self, metadata: ModuleMetadata, *, is_batch: bool) -> None:
        """Raise if a module refuses its metadata, or if a part belongs to no module.

        Raises:
            InvalidInputError: Names the field.
        """
        parts = {module.metadata_part for module in self.all}
        known = parts - OWN_PARTS
        for name, value in metadata.custom.items():
            if name not in known or not isinstance(value, Mapping):
                listed = ", ".join(sorted(known))
                expected = f"a mapping for a module: one of {listed}{did_you_mean(name, parts)}"
                raise InvalidInputError(f"metadata.custom.{name}", value, expected)
        for module in self.all:
            part = metadata.part(module.metadata_part)
            if is_batch:
                module.check(part)
            elif part:
                module.check_sample(part)

    def draw(
        self,
        batch_id: int,
        seeds: BatchSeeds,
        metadata: ModuleMetadata,
        kept: Batch | None,
        progress: ProgressCallback,
    ) -> Batch:
        """Return a new batch; if a module raises, all of them are as before.

        Args:
            batch_id: Its id.
            seeds: Its seeds.
            metadata: Its metadata, including that of what it keeps.
            kept: The previous batch, whose stage is reused if the new batch has the same one.
            progress: Receives the progress, up to `DRAW_SHARE`; may raise `CancelledError`.
        """
        before = Snapshot(*self.all)
        batch = Batch(batch_id, seeds, metadata=metadata)
        try:
            for index, module in enumerate(self.all):
                progress(Progress(module.name, DRAW_SHARE * index / len(self.all)))
                if module.name in STAGE_MODULES and kept and same_stage(seeds, metadata, kept):
                    batch.world.keep_stage(kept.world)
                    continue
                rng = randomness.stream(_seed_of(module, seeds), module.name)
                module.step_batch(batch.world, metadata.part(module.metadata_part), rng)
            _note_in_force(batch, self.all)
        except BaseException:
            before.restore()
            raise
        return batch

    def step_sample(self, batch: Batch, metadata: ModuleMetadata) -> None:
        """Update a batch for its next sample, by the modules that have something to change."""
        world = batch.world
        world.sample_id = batch.sample_id + 1
        # An extension may change at each sample what the others have set, so they set it again.
        is_extended = any(isinstance(module, ExtensionModule) for module in self.all)
        changing = [
            module
            for module in self.all
            if is_extended or module.changes_by_itself or metadata.part(module.metadata_part)
        ]
        for module in changing:
            rng = randomness.stream(batch.seeds.seed, module.name, world.sample_id)
            module.step_sample(world, metadata.part(module.metadata_part), rng)
        batch.metadata = batch.metadata.with_update(metadata)
        _note_in_force(batch, changing)


def _note_in_force(batch: Batch, modules: Iterable[Module]) -> None:
    """Update ``in_force`` of a batch by modules that have changed."""
    own: dict[str, Any] = {}
    custom = dict(batch.in_force.custom)
    for module in modules:
        name = module.metadata_part
        part = dict(module.in_force(batch.metadata.part(name)) or {})
        (own if name in OWN_PARTS else custom)[name] = part
    custom = {name: part for name, part in custom.items() if part}
    batch.in_force = replace(batch.in_force, **own, custom=custom)


def _rock_textures(config: SimulationConfig) -> tuple[int | None, int]:
    return config.materials.texture_size_px, config.materials.texture_seed


def _seed_of(module: Module, seeds: BatchSeeds) -> int:
    if module.name in STAGE_MODULES:
        return seeds.stage_seed
    return seeds.asset_seed if isinstance(module, AssetsModule) else seeds.seed
