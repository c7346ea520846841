"""The core's shell commands: ``oaisys render`` and ``oaisys config``.

``oaisys --help`` imports this module, so slow imports are done on use.
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.cli.names import names
from oaisys_core.cli.options import (
    BackendOption,
    ConfigOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_core.cli.rendering.run import render
from oaisys_core.cli.standard_output import write_or_print

__all__ = ["config_app", "render"]

config_app = typer.Typer(
    help="Check configuration files.", no_args_is_help=True, add_completion=False
)

config_app.command("names")(names)


@config_app.command("check")
def check(file: Annotated[Path, typer.Argument(help="YAML file to check.")]) -> None:
    """Validate FILE and report each error with its line, path and expected value.

    This includes the names of terrains, textures, shapes, effects and extensions, and the content
    of files.
    """
    from oaisys_core.config import config_sha256, load_config
    from oaisys_core.config.loading import with_lines
    from oaisys_core.errors import ConfigError
    from oaisys_core.world.config_files import name_faults, texture_notes

    config = load_config(file)
    faults = name_faults(config)
    if faults:
        raise ConfigError("\n".join(with_lines(file, faults)))
    for note in texture_notes(config):
        typer.echo(note)
    typer.echo(f"{file}: valid, sha256 {config_sha256(config)}")


@config_app.command("show")
def show(
    config: ConfigOption = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
    world: Annotated[
        int | None,
        typer.Option(
            help="Print the configuration of this world, counted from 0, with all that it draws.",
            min=0,
        ),
    ] = None,
) -> None:
    """Print the complete configuration, defaults included, as JSON (which is also YAML)."""
    from oaisys_core.config import SimulationConfig, adjust, load_config
    from oaisys_core.config.worlds import WorldSeeds, draw_world
    from oaisys_core.randomness import batch_seed

    loaded = load_config(config) if config else SimulationConfig()
    shown = adjust(loaded, seed=seed, backend=backend, quality=quality, size=size)
    if world is not None:
        shown = draw_world(shown, WorldSeeds.of(batch_seed(shown.seed, world + 1))).config
    typer.echo(json.dumps(shown.model_dump(mode="json"), indent=2))


@config_app.command("schema")
def schema(
    out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None,
) -> None:
    """Write the JSON Schema of configuration files, for editors and other programs."""
    from oaisys_core.config.schema import schema_text

    write_or_print(schema_text(), out)


@config_app.command("reference")
def reference(
    out: Annotated[Path | None, typer.Option(help="File to write; default: print it.")] = None,
) -> None:
    """Write the page that lists every key with its type, range, default and meaning."""
    from oaisys_core.config.reference import reference_text

    write_or_print(reference_text(), out)


@config_app.command("import")
def import_(
    file: Annotated[Path, typer.Argument(help="JSON file of the original simulator.")],
    out: Annotated[Path | None, typer.Option(help="YAML file to write; default: print it.")] = None,
    assets: Annotated[
        Path | None, typer.Option(help="Folder from which relative paths in the file start.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Treat missing files and unknown keys as errors.")
    ] = False,
    stand_ins: Annotated[
        Path | None,
        typer.Option(
            help="Folder for generated materials, meshes and images that replace missing ones."
        ),
    ] = None,
) -> None:
    """Convert an original OAISYS configuration to ours, and report what becomes of each key."""
    from oaisys_core.config import config_from_mapping
    from oaisys_core.errors import ConfigError
    from oaisys_core.importing.importer import import_file
    from oaisys_core.world.config_files import name_faults

    imported = import_file(file, assets, out, strict=strict, stand_ins=stand_ins)
    faults = name_faults(config_from_mapping(imported.config))
    if faults and strict:
        raise ConfigError("\n".join(f"{file}: {fault}" for fault in faults))
    imported = replace(imported, warnings=(*imported.warnings, *faults))
    write_or_print(imported.text(file.name), out)
    if out is not None:
        counts = Counter(outcome.kind for outcome in imported.outcomes.values())
        summary = ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items()))
        typer.echo(
            "\n".join([*imported.notes(), f"{out}: {len(imported.outcomes)} keys: {summary}"])
        )
