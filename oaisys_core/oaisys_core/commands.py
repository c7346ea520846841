"""The core's shell commands: ``oaisys render`` and ``oaisys config``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress as ProgressBar

from oaisys_core.config import SimulationConfig, adjusted, config_sha256, load_config
from oaisys_core.config.reference import reference_text
from oaisys_core.config.schema import schema_text
from oaisys_core.errors import InvalidInputError
from oaisys_core.output import SampleWriter, read_poses
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Sample

config_app = typer.Typer(help="Check configuration files.", no_args_is_help=True)

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="YAML file; the default world where none is given.")
]
SeedOption = Annotated[int | None, typer.Option(help="Root seed.")]
BackendOption = Annotated[str | None, typer.Option(help="blender or analytic.")]
QualityOption = Annotated[
    str | None, typer.Option(help="Of colour: preview, standard, high or final.")
]
SizeOption = Annotated[
    str | None, typer.Option(help="WIDTHxHEIGHT of all images; K is scaled along.")
]


@config_app.command("check")
def check(file: Annotated[Path, typer.Argument(help="YAML file to check.")]) -> None:
    """Validate FILE; every fault is told with its line, its path and what was expected."""
    config = load_config(file)
    typer.echo(f"{file}: valid, sha256 {config_sha256(config)}")


@config_app.command("show")
def show(
    config: ConfigOption = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
) -> None:
    """Print the whole configuration, defaults included, as JSON (which is also YAML)."""
    loaded = load_config(config) if config else SimulationConfig()
    shown = adjusted(loaded, seed=seed, backend=backend, quality=quality, size=size)
    typer.echo(json.dumps(shown.model_dump(mode="json"), indent=2))


@config_app.command("schema")
def schema(
    out: Annotated[Path | None, typer.Option(help="File to write; else it is printed.")] = None,
) -> None:
    """Write the JSON Schema of configuration files, which editors and other programs understand."""
    _write_or_print(schema_text(), out)


@config_app.command("reference")
def reference(
    out: Annotated[Path | None, typer.Option(help="File to write; else it is printed.")] = None,
) -> None:
    """Write the page that lists every key with its type, range, default and meaning."""
    _write_or_print(reference_text(), out)


def _write_or_print(text: str, out: Path | None) -> None:
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InvalidInputError("out", str(out), f"a file that can be written ({error})") from error


def render(
    out: Annotated[Path, typer.Option("--out", help="Folder for the images.")],
    config: ConfigOption = None,
    batches: Annotated[int, typer.Option(help="Worlds to build.", min=1)] = 1,
    samples: Annotated[int, typer.Option(help="Views of each world.", min=1)] = 1,
    poses: Annotated[
        Path | None,
        typer.Option(help="CSV of rig poses, as poses.csv is written; its rows are the views."),
    ] = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
) -> None:
    """Render batches and samples to files, without ROS and without a server.

    Without --poses the rig stays above the ground's centre, looking down.
    """
    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjusted(loaded, seed=seed, backend=backend, quality=quality, size=size)
    views: list[Pose | None] = [*read_poses(poses)] if poses else [None] * samples
    simulation = Simulation(chosen)
    try:
        _render_all(simulation, SampleWriter(out), batches, views)
    finally:
        simulation.close()


def _render_all(
    simulation: Simulation, writer: SampleWriter, batches: int, views: list[Pose | None]
) -> None:
    console = Console()
    with ProgressBar(console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("rendering", total=batches * len(views))
        for _ in range(batches):
            simulation.step_batch()
            for pose in views:
                sensor = None if pose is None else {"pose": pose}
                sample = simulation.step_sample(ModuleMetadata(sensor=sensor))
                writer.write(sample)
                bar.advance(task)
                _report(console, sample)


def _report(console: Console, sample: Sample) -> None:
    if not console.is_terminal:
        typer.echo(
            f"batch {sample.batch_id} sample {sample.sample_id}: {sample.render_time_s:.2f} s"
        )
