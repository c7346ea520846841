"""``oaisys drive``: timed drives, planned and recorded."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from oaisys_core.cli.options import (
    BackendOption,
    ConfigOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.extensions import DRIVE_RECORDERS, DRIVE_REPORTS
from oaisys_core.files.whole_files import check_output_file

if TYPE_CHECKING:
    from oaisys_core.config import SimulationConfig
    from oaisys_core.drive.drive import Drive
    from oaisys_core.drive.outputs import (
        DriveDescription,
        DriveRecorder,
        RecordedDrive,
        StreamCount,
    )
    from oaisys_core.simulation import Simulation
    from oaisys_core.trajectory.planning import DrivePlan
    from oaisys_core.types import DriveInstant

drive_app = typer.Typer(add_completion=False, invoke_without_command=True)

FILES, BAG, REPORT = "files", "bag", "html"
"""Outputs of a drive; the latter two are the names of extensions."""

PACKAGES = {BAG: "oaisys_ros_bridge", REPORT: "oaisys_mapping"}
"""Packages that have these extensions."""


@drive_app.callback()
def drive(
    context: typer.Context,
    config: ConfigOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Output folder.")] = None,
    bag: Annotated[
        bool | None,
        typer.Option(
            "--bag/--no-bag",
            help="Write the rosbag2 MCAP OUT/bag; default: where the ROS packages are installed.",
        ),
    ] = None,
    report: Annotated[
        bool | None,
        typer.Option(
            "--report/--no-report",
            help="Write OUT/report.html and report.json; default: where oaisys_mapping is "
            "installed.",
        ),
    ] = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
) -> None:
    """Drive through a world, with every sensor at its rate, and record it: files, bag, report.

    The section `drive` of the configuration gives the vehicle and its waypoints. Cameras, lidars
    and IMUs measure at their `rate_hz`, in simulated time. Images, scans, IMU and odometry are
    always written as files; the bag has the same on the topics of the ROS bridge, and the report
    shows it and what independent odometry programs make of it. Exit code 1 if a measurement that
    was due is missing from the files or the bag.
    """
    if context.invoked_subcommand is not None:
        return
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.config import SimulationConfig, adjust, load_config
    from oaisys_core.drive.drive import Drive, drive_section
    from oaisys_core.files.folders import own_folder
    from oaisys_core.simulation import Simulation

    if out is None:
        raise InvalidInputError("out", None, "a folder, as --out")
    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjust(loaded, seed=seed, backend=backend, quality=quality, size=size)
    drive_section(chosen)
    unavailable: dict[str, str] = {}
    with own_folder(out), own_stdout():
        simulation = Simulation(chosen)
        try:
            # After the backend, because Blender must be loaded before Open3D.
            open_bag = _extension(DRIVE_RECORDERS, BAG, bag, unavailable)
            write_report = _extension(DRIVE_REPORTS, REPORT, report, unavailable)
            simulation.step_batch()
            planned = Drive(simulation, chosen)
            _say_plan(planned.plan)
            if not planned.sample_count():
                expected = "a drive so long that an image or a scan is due"
                raise InvalidInputError("drive", f"{planned.duration_s:g} s", expected)
            recorded = _record(simulation, planned, chosen, out, open_bag, unavailable)
        finally:
            simulation.close()
    if write_report is not None:
        typer.echo(f"report: {write_report(recorded, _say)}")
    counts = recorded.counts[FILES]
    typer.echo(f"{out}: {', '.join(f'{count.written} {name}' for name, count in counts.items())}")
    for sentence in recorded.losses:
        typer.echo(f"missing: {sentence}", err=True)
    if recorded.losses:
        raise typer.Exit(1)


def _extension(
    group: str, name: str, wanted: bool | None, unavailable: dict[str, str]
) -> Callable[..., Any] | None:
    """Return an output of another package; None if it is not wanted, or not required and missing.

    Raises:
        ConfigError: It is required and not installed.
    """
    from oaisys_core import extensions

    if wanted is False:
        return None
    try:
        if name not in extensions.names(group):
            raise ConfigError(f"the package {PACKAGES[name]} is not installed")
        found: Callable[..., Any] = extensions.load(group, name)
    except ConfigError as error:
        if wanted:
            raise
        unavailable[name] = str(error)
        typer.echo(f"without {name}: {error}", err=True)
        return None
    return found


def _say(text: str) -> None:
    typer.echo(text, err=True)


@drive_app.command("plan")
def plan(
    config: Annotated[Path, typer.Argument(help="YAML file with a section `drive`.")],
    out: Annotated[
        Path, typer.Option("--out", help="CSV file to write, or TUM file (.tum, .txt).")
    ],
    seed: SeedOption = None,
    backend: BackendOption = "analytic",
) -> None:
    """Plan the drive of CONFIG and write its trajectory, without recording anything.

    The file has the poses that a smooth trajectory interpolates, 0.05 s apart. It can be driven
    with the vehicle `{kind: file, path: FILE}`. A rover that stops in front of an obstacle ends
    with exit code 1, after the trajectory up to there was written.
    """
    from oaisys_core.config import adjust, load_config
    from oaisys_core.drive.drive import drive_section
    from oaisys_core.simulation import Simulation
    from oaisys_core.trajectory.files import write_trajectory
    from oaisys_core.trajectory.planning import plan_drive

    check_output_file(out)
    chosen = adjust(load_config(config), seed=seed, backend=backend)
    section = drive_section(chosen)
    with own_stdout():
        simulation = Simulation(chosen)
        try:
            simulation.step_batch()
            heights = partial(simulation.query_height, on_stage=True)
            info = simulation.info()
            planned = plan_drive(section, heights, info.sensors, info.georeference)
        finally:
            simulation.close()
    write_trajectory(out, planned.trajectory)
    _say_plan(planned)
    if planned.obstacle is not None:
        raise typer.Exit(1)


def _say_plan(planned: DrivePlan) -> None:
    seconds = planned.end_s - planned.trajectory.start_s
    typer.echo(f"the way: {planned.length_m():.1f} m in {seconds:.1f} s")
    if planned.obstacle is not None:
        typer.echo(f"the rover stops in front of {planned.obstacle}", err=True)


def _record(
    simulation: Simulation,
    planned: Drive,
    config: SimulationConfig,
    out: Path,
    open_bag: Callable[[DriveDescription], DriveRecorder] | None,
    unavailable: Mapping[str, str],
) -> RecordedDrive:
    """Drive, write files and bag, and return what was recorded."""
    from rich.console import Console

    from oaisys_core.cli.rendering.progress import RenderProgress
    from oaisys_core.drive.recorded_drive import (
        PictureCollector,
        description_of,
        drive_record,
        drive_through,
    )
    from oaisys_core.drive.recording import DriveWriter

    began_s = time.perf_counter()
    description = description_of(planned, simulation, out)
    files = DriveWriter(planned, description, config)
    pictures = PictureCollector(description)
    outputs: dict[str, DriveRecorder] = {FILES: files}
    if open_bag is not None:
        outputs[BAG] = open_bag(description)
    with RenderProgress(planned.sample_count(), 0, Console()) as shown:
        shown.begin("driving")

        def show(instant: DriveInstant) -> None:
            if instant.sample is not None:
                shown.view_done()
                shown.begin(f"{instant.time_ns / 1e9:.2f} s")

        counts = drive_through(planned, outputs, [pictures.take, show], shown)
    summary = _summary(description, counts[FILES], time.perf_counter() - began_s)
    files.write_summary(summary)
    info = description.info
    facts = {
        **summary,
        "seed": info.seed,
        "config_sha256": info.config_sha256,
        "backend": info.backend,
        "backend_version": info.backend_version,
        "quality": info.quality,
    }
    return drive_record(
        planned,
        simulation,
        description,
        config,
        pictures=pictures.pictures,
        counts=counts,
        unavailable=unavailable,
        facts=facts,
        command=shlex.join(["oaisys", *sys.argv[1:]]),
    )


def _summary(
    description: DriveDescription, counts: Mapping[str, StreamCount], seconds: float
) -> dict[str, Any]:
    """Return the contents of ``drive.json``."""
    return {
        "start_s": description.start_s,
        "end_s": description.end_s,
        "length_m": description.length_m,
        "obstacle": description.obstacle or None,
        "rate_hz": dict(description.rates_hz),
        "due": dict(description.due),
        "recorded": {name: count.written for name, count in counts.items()},
        "seconds": seconds,
    }
