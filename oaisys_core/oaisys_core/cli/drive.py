"""``oaisys drive``: timed drives, planned and recorded to files."""

from __future__ import annotations

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
from oaisys_core.errors import InvalidInputError

if TYPE_CHECKING:
    from oaisys_core.config import SimulationConfig
    from oaisys_core.drive.drive import Drive
    from oaisys_core.drive.recording import DriveWriter
    from oaisys_core.simulation import Simulation
    from oaisys_core.trajectory.planning import DrivePlan

drive_app = typer.Typer(add_completion=False, invoke_without_command=True)


@drive_app.callback()
def drive(
    context: typer.Context,
    config: ConfigOption = None,
    out: Annotated[Path | None, typer.Option("--out", help="Output folder.")] = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
) -> None:
    """Drive through a world, with every sensor at its rate, and record it to files.

    The section `drive` of the configuration gives the vehicle and its waypoints. Cameras, lidars
    and IMUs measure at their `rate_hz`, in simulated time. Exit code 1 if a measurement that was
    due is missing.
    """
    if context.invoked_subcommand is not None:
        return
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_core.config import SimulationConfig, adjusted, load_config
    from oaisys_core.drive.drive import Drive, drive_section
    from oaisys_core.drive.recording import DriveWriter
    from oaisys_core.simulation import Simulation

    if out is None:
        raise InvalidInputError("out", None, "a folder, as --out")
    loaded = load_config(config) if config else SimulationConfig()
    chosen = adjusted(loaded, seed=seed, backend=backend, quality=quality, size=size)
    drive_section(chosen)
    with own_stdout():
        simulation = Simulation(chosen)
        try:
            simulation.step_batch()
            planned = Drive(simulation, chosen)
            _say_plan(planned.plan)
            writer = DriveWriter(out)
            writer.begin(chosen, planned.plan.trajectory)
            report = _recorded(simulation, planned, chosen, writer)
            writer.finish(chosen, report)
        finally:
            simulation.close()
    typer.echo(f"{out}: {', '.join(f'{n} {name}' for name, n in report['recorded'].items())}")
    if report["recorded"] != report["due"]:
        raise typer.Exit(1)


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
    from oaisys_core.config import adjusted, load_config
    from oaisys_core.drive.drive import drive_section
    from oaisys_core.simulation import Simulation
    from oaisys_core.trajectory.files import write_trajectory
    from oaisys_core.trajectory.planning import plan_drive

    chosen = adjusted(load_config(config), seed=seed, backend=backend)
    section = drive_section(chosen)
    with own_stdout():
        simulation = Simulation(chosen)
        try:
            simulation.step_batch()
            planned = plan_drive(section, simulation.query_height)
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


def _recorded(
    simulation: Simulation, planned: Drive, config: SimulationConfig, writer: DriveWriter
) -> dict[str, Any]:
    """Record the drive, and return its report."""
    import time

    from rich.console import Console

    from oaisys_core.cli.render_progress import RenderProgress
    from oaisys_core.drive.drive import ODOMETRY

    due = planned.schedule.counts
    recorded = dict.fromkeys(due, 0)
    began_s = time.perf_counter()
    odometry = planned.odometry()
    writer.write_odometry(odometry)
    recorded[ODOMETRY] = len(odometry.times_s)
    for imu in config.sensors.imus:
        measurements = planned.imu_measurements(imu.name)
        writer.write_imu(imu.name, planned.schedule.times_ns(imu.name).tolist(), measurements)
        recorded[imu.name] = len(measurements.times_s)
    with RenderProgress(planned.sample_count(), 0, Console()) as shown:
        shown.begin("driving")
        for view in planned.samples(shown):
            labels = dict(simulation.info().semantic_labels)
            writer.write_sample(view.time_ns, view.sensors, view.sample, labels)
            for name in view.sensors:
                recorded[name] += 1
            shown.view_done()
            shown.begin(f"{view.time_ns / 1e9:.2f} s")
    obstacle = planned.plan.obstacle
    return {
        "start_s": planned.plan.trajectory.start_s,
        "end_s": planned.plan.end_s,
        "length_m": planned.plan.length_m(),
        "obstacle": None if obstacle is None else str(obstacle),
        "rate_hz": planned.rates_hz,
        "due": due,
        "recorded": recorded,
        "seconds": time.perf_counter() - began_s,
    }
