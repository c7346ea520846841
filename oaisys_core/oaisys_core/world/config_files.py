"""Checks that everything a configuration names exists, before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import BackendUnavailableError, ConfigError, InvalidInputError
from oaisys_core.procedural.environment.hdri import images_of, read_radiance
from oaisys_core.procedural.meshes.files import load_mesh
from oaisys_core.procedural.terrain.dem import import_dem
from oaisys_core.world.extension_modules import make_modules
from oaisys_core.world.modules import (
    AssetsModule,
    EnvironmentModule,
    MaterialsModule,
    RenderModule,
    SensorsModule,
    StageModule,
)


def name_faults(config: SimulationConfig) -> list[str]:
    """Return one line, starting with the path, for each name or file that is missing or invalid.

    All modules are created as for rendering, and the files of the stage are read. Nothing is
    rendered, and no texture is made.
    """
    found: list[str] = []
    for check in _checks(config):
        try:
            check()
        except (InvalidInputError, ConfigError, BackendUnavailableError) as error:
            found.extend(str(error).splitlines())
    return list(dict.fromkeys(found))


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
        load_mesh(stage.mesh.file, stage.mesh.object, "stage.mesh.file")
    elif stage.dem is not None:
        import_dem(stage.dem)


def _sky_images(config: SimulationConfig) -> None:
    if config.environment.hdri is not None:
        for image in images_of(config.environment.hdri):
            read_radiance(image.file)
