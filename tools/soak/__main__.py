"""The soak test: ``python -m tools.soak --samples 5000``; exit 1 if something has grown."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import psutil
import typer

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Pose
from oaisys_ros_bridge.experiments.bringup import MAP_TIMEOUT_S, SimulatorStack, bring_up
from oaisys_ros_bridge.experiments.configuration import ExperimentOptions
from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals, raise_if_interrupted
from oaisys_ros_bridge.experiments.planner_client import PlannerClient
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.nodes.bridge import THREADS
from tools.soak.counts import Gauge, busy_loops, missing_in_bag, read_gauges

PLACES = 40
"""Positions that are visited in turn: after one round the map does not grow any more."""
JITTER_M = 0.05
"""Added to positions, so that no pose is repeated and answered from the pose cache."""
ALTITUDE_M = 8.0
VIEW_TIMEOUT_S = 120.0
POSE_CACHE_MB = 8
"""So small that the cache is full long before the first reading."""
FIRST_READING = 50
GROWTH_RATIO = 0.05
GROWTH_MB = 12.0
"""A process may exceed its first reading by the larger of both, which allocators account for."""

Readings = dict[int, Mapping[str, Gauge]]
"""Gauges by number of samples and process."""


def main(
    samples: Annotated[int, typer.Option(min=1, help="Number of samples.")] = 5000,
    out: Annotated[Path, typer.Option(help="Folder of bag, logs and soak.json.")] = Path(
        "out/soak"
    ),
    size: Annotated[str, typer.Option(help="Size of the images, WIDTHxHEIGHT.")] = "160x120",
    record: Annotated[bool, typer.Option(help="Record the samples to a bag.")] = True,
    backend: Annotated[str, typer.Option(help="analytic or blender.")] = "analytic",
    sweep: Annotated[
        bool, typer.Option(help="Render all poses in one sweep instead of one call each.")
    ] = False,
    busy: Annotated[
        int, typer.Option(min=0, help="Number of busy loops that load the machine.")
    ] = 0,
) -> None:
    """Render thousands of samples and print memory, descriptors, threads and shared segments.

    Exit 1 if something has grown, or if map or bag have lost a message of a sample.
    """
    interrupt_on_signals()
    options = ExperimentOptions(
        out=out,
        config=None,
        overrides={"backend": backend, "size": size, "quality": "preview"},
        voxel_size_m=0.2,
        max_range_m=30.0,
        record=record,
        worker_python=None,
        command=["soak"],
        server_options=["--pose-cache-mb", str(POSE_CACHE_MB)],
    )
    reporter = Reporter()
    try:
        with busy_loops(busy):
            readings, faults = run(options, samples, reporter, sweep=sweep)
        if record:
            faults += missing_in_bag(out / "bag", samples)
    except OaisysError as error:
        reporter.say(f"failed: {error}")
        raise typer.Exit(1) from error
    figures = {str(n): {name: asdict(g) for name, g in row.items()} for n, row in readings.items()}
    (out / "soak.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    for line in table(readings):
        typer.echo(line)
    if len(readings) > 1:
        faults += growths(readings)
    if not faults:
        typer.echo(f"all {samples} samples are in the map" + (" and in the bag" if record else ""))
    for fault in faults:
        typer.echo(fault)
    raise typer.Exit(int(bool(faults)))


def run(
    options: ExperimentOptions, samples: int, reporter: Reporter, *, sweep: bool
) -> tuple[Readings, list[str]]:
    """Render the samples; return the readings, and what the map has lost.

    Raises:
        OaisysError: A process failed, or did not answer in time.
    """
    readings: Readings = {}
    reading_at = reading_points(samples)
    root = psutil.Process()
    with bring_up(options, PlannerClient, reporter) as stack:
        if sweep:
            poses = list(viewpoints(samples))
            result = stack.client.sweep(poses, "map", VIEW_TIMEOUT_S * samples)
            faults = [result.message] if result.message else []
            frames = stack.client.save_mesh(
                str((options.out / "mesh.ply").resolve()), MAP_TIMEOUT_S
            )
            if frames.frames != samples or frames.message:
                faults.append(f"map: {frames.frames} of {samples} samples; {frames.message}")
            return {samples: read_gauges(root)}, faults
        for number, pose in enumerate(reporter.track(list(viewpoints(samples)), "samples"), 1):
            raise_if_interrupted()
            take(stack, pose)
            if number in reading_at:
                stack.client.status.wait_for_map(number, MAP_TIMEOUT_S)
                readings[number] = read_gauges(root)
                for line in table({number: readings[number]})[1:]:
                    reporter.say(line)
        return readings, stack.client.shortfalls(MAP_TIMEOUT_S)


def take(stack: SimulatorStack[PlannerClient], pose: Pose) -> None:
    """Render one view and wait for its images."""
    stack.client.view(pose, stack.posed_sensor, "map", VIEW_TIMEOUT_S)


def reading_points(samples: int) -> set[int]:
    """Return the numbers of samples after which the gauges are read."""
    first = min(FIRST_READING, max(1, samples // 2))
    steps = {round(samples * share) for share in (0.1, 0.2, 0.4, 0.5, 0.6, 0.8)}
    return {first, samples} | {step for step in steps if step > first}


def viewpoints(samples: int) -> Iterator[Pose]:
    """Yield different poses that look down at the middle of the world."""
    rng = np.random.default_rng(0)
    places_m = rng.uniform(-6.0, 6.0, size=(PLACES, 2))
    for number in range(samples):
        x_m, y_m = places_m[number % PLACES] + rng.uniform(-JITTER_M, JITTER_M, 2)
        yield pose_looking_down(float(x_m), float(y_m), ALTITUDE_M)


def table(readings: Readings) -> Sequence[str]:
    """Return the readings as lines of text, below a line of names."""
    names = f"{'PSS MB':>8} {'own MB':>8} {'fds':>5} {'thr':>4} {'shm':>4}"
    return [
        f"{'samples':>8} {'process':<9} {names}",
        *(
            f"{number:>8} {name:<9} {g.pss_mb:>8.1f} {g.private_mb:>8.1f} {g.descriptors:>5}"
            f" {g.threads:>4} {g.shared_segments:>4}"
            for number, row in readings.items()
            for name, g in sorted(row.items())
        ),
    ]


def growths(readings: Readings) -> Sequence[str]:
    """Return a sentence for each gauge that has grown by more than it may."""
    first, last = (readings[number] for number in (min(readings), max(readings)))
    faults = []
    for name, end in last.items():
        begin = first.get(name)
        if begin is None:
            faults.append(f"{name}: was replaced")
            continue
        for unit, before, after, spare in (
            ("MB", begin.private_mb, end.private_mb, growth_mb(begin.private_mb)),
            ("descriptors", begin.descriptors, end.descriptors, 2),
            # The executor starts its threads when they are first needed.
            ("threads", begin.threads, end.threads, THREADS),
            ("shared segments", begin.shared_segments, end.shared_segments, 1),
        ):
            if after > before + spare:
                faults.append(f"{name}: {before:.0f} {unit} have become {after:.0f}")
    return faults


def growth_mb(before_mb: float) -> float:
    """Return by how much a process may have grown."""
    return max(GROWTH_MB, GROWTH_RATIO * before_mb)


if __name__ == "__main__":
    typer.run(main)
