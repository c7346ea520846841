"""Checks that everything a configuration names exists, before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pydantic import BaseModel

from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.layers import LookConfig
from oaisys_core.config.worlds import contradictions, possible_configs
from oaisys_core.errors import BackendUnavailableError, ConfigError, InvalidInputError
from oaisys_core.procedural.environment.hdri import images_of, read_radiance
from oaisys_core.procedural.terrain.dem import import_dem
from oaisys_core.procedural.textures.folder import describe_texture_folder
from oaisys_core.world.extension_modules import make_modules
from oaisys_core.world.modules import (
    AssetsModule,
    EnvironmentModule,
    MaterialsModule,
    RenderModule,
    SensorsModule,
    StageModule,
)
from oaisys_core.world.modules.layers import pool_layers
from oaisys_core.world.modules.stage import load_mesh_ground


def name_faults(config: SimulationConfig) -> list[str]:
    """Return one line, starting with the path, for each name or file that is missing or invalid.

    All modules are created as for rendering, and the files of the stage are read. Nothing is
    rendered, and no texture is made. Each value that a world may draw is checked, and some worlds
    are drawn, whose values may not fit together.
    """
    found: list[str] = []
    for check in _checks_of_all(config):
        try:
            check()
        except (InvalidInputError, ConfigError, BackendUnavailableError) as error:
            found.extend(str(error).splitlines())
    return list(dict.fromkeys((*found, *contradictions(config))))


def texture_notes(config: SimulationConfig) -> list[str]:
    """Return for each texture folder which map is used for what, and what is left aside."""
    folders: list[Path] = []
    for each in possible_configs(config):
        folders.extend(look.folder for look in _looks(each) if look.folder is not None)
        for pool in each.materials.pools:
            folders.extend(layer.folder for layer in pool_layers(pool) if layer.folder is not None)
    return [describe_texture_folder(folder) for folder in dict.fromkeys(folders)]


def _looks(value: object) -> Iterator[LookConfig]:
    """Yield the looks anywhere in a section."""
    if isinstance(value, LookConfig):
        yield value
    if isinstance(value, BaseModel):
        value = [each for _, each in value]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for each in value:
            yield from _looks(each)


def _checks_of_all(config: SimulationConfig) -> Iterator[Callable[[], object]]:
    """Yield the checks of all that a configuration may become, but each section only once."""
    checked: list[tuple[object, ...]] = []
    for each in possible_configs(config):
        sections = (each.stage, each.materials, each.assets, each.environment, each.sensors)
        if sections not in checked:
            checked.append(sections)
            yield from _checks(each)


def _checks(config: SimulationConfig) -> Iterator[Callable[[], object]]:
    materials = config.materials
    yield lambda: _stage(config)
    yield lambda: MaterialsModule(materials)
    yield lambda: AssetsModule(config.assets, materials.texture_size_px, materials.texture_seed)
    yield lambda: EnvironmentModule(config.environment).setup()
    yield lambda: _sky_images(config)
    yield lambda: SensorsModule(config.sensors)
    yield lambda: RenderModule(config.render, config.sensors.modalities)
    for name, options in sorted(config.extensions.items()):
        yield lambda name=name, options=options: make_modules({name: options})  # type: ignore[misc]


def _stage(config: SimulationConfig) -> None:
    stage = config.stage
    module = StageModule(stage)
    if stage.reuse is not None:
        module.record(stage.reuse)
    elif stage.mesh is not None:
        load_mesh_ground(stage.mesh)
    elif stage.dem is not None:
        import_dem(stage.dem)


def _sky_images(config: SimulationConfig) -> None:
    if config.environment.hdri is not None:
        for image in images_of(config.environment.hdri):
            read_radiance(image.file)
