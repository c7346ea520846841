"""Runs the benchmarks: ``python -m tools.bench``; ``make bench`` does."""

from __future__ import annotations

import re
import signal
import traceback
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import Annotated, NamedTuple, get_args

import typer
from rich.console import Console

from oaisys_core.errors import OaisysError
from oaisys_core.sensing.render_settings import Device
from tools.bench.figures import Figure
from tools.bench.machine import machine
from tools.bench.report import TopicProgress, print_table, write_results
from tools.bench.settings import Say, Settings
from tools.bench.topics import (
    cores,
    dataset,
    draft,
    growth,
    light,
    maps,
    panel,
    quality,
    referees,
    rendering,
    reproducibility,
    transport,
)
from tools.bench.worlds.panel import SIX_VIEWS, WORLDS


class Topic(NamedTuple):
    """How a topic is measured, and the seconds that it takes on two cores: in full, and quickly."""

    run: Callable[[Settings, Say], list[Figure]]
    full_s: float
    quick_s: float


TOPICS = {
    "panel": Topic(panel.run, 5400, 600),
    "draft": Topic(draft.run, 900, 240),
    "quality": Topic(quality.run, 2400, 400),
    "plain": Topic(rendering.plain, 240, 60),
    "cores": Topic(cores.run, 800, 240),
    "batches": Topic(rendering.batches, 400, 120),
    "sync": Topic(rendering.sync, 60, 40),
    "budget": Topic(rendering.budget, 220, 60),
    "growth": Topic(growth.run, 700, 150),
    "dataset": Topic(dataset.run, 6500, 500),
    "equality": Topic(rendering.equality, 150, 80),
    "reproducibility": Topic(reproducibility.run, 400, 160),
    "transfer": Topic(transport.transfer, 110, 45),
    "publish": Topic(transport.publish, 60, 30),
    "end_to_end": Topic(transport.end_to_end, 120, 60),
    "mapping": Topic(maps.mapping, 120, 60),
    "planning": Topic(maps.planning, 60, 40),
    "referees": Topic(referees.run, 3600, 500),
    "light": Topic(light.run, 600, 600),
}
QUICK_RUNS = 2
PANEL = (*WORLDS, SIX_VIEWS)
DEVICES = get_args(Device)


def main(
    out: Annotated[Path, typer.Option(help="Folder for figures, plots, references.")] = Path(
        "out/bench"
    ),
    only: Annotated[
        list[str] | None, typer.Option(help=f"A topic, repeatable: {', '.join(TOPICS)}.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer values, and references of fewer samples.")
    ] = False,
    runs: Annotated[
        int | None, typer.Option(min=1, help="Values per figure: 5, or 2 with --quick.")
    ] = None,
    size: Annotated[str, typer.Option(help="Of images, WIDTHxHEIGHT.")] = "640x480",
    final: Annotated[
        bool, typer.Option("--final", help="Also measure the preset final, a minute per view.")
    ] = False,
    plain_views: Annotated[
        int, typer.Option(min=1, max=6, help="Views for the topic plain, 3 minutes each.")
    ] = 1,
    device: Annotated[
        str, typer.Option(help=f"render.device of all topics: {', '.join(DEVICES)}.")
    ] = "auto",
    worlds: Annotated[
        list[str] | None,
        typer.Option(help=f"A world of the panel, repeatable: {', '.join(PANEL)}; default: all."),
    ] = None,
    views_seed: Annotated[
        int, typer.Option(min=0, help="Seed of the panel's random views.")
    ] = Settings.views_seed,
    against: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            help="Root of another checkout: the panel compares its times with ours, in turns.",
        ),
    ] = None,
) -> None:
    """Measure, show each figure beside its goal, and write bench.json, bench.md and plots.

    The exit code is 1 if a topic fails, but not if a goal is missed.
    """
    chosen = only or list(TOPICS)
    _check_names("--only", chosen, TOPICS)
    _check_names("--worlds", worlds or (), PANEL)
    _check_names("--device", [device], DEVICES)
    if against is not None and chosen != ["panel"]:
        raise typer.BadParameter("--against: only the panel compares, add --only panel")
    settings = Settings(
        out=out.absolute(),
        runs=runs or (QUICK_RUNS if quick else Settings.runs),
        quick=quick,
        with_final=final,
        plain_views=plain_views,
        device=device,
        worlds=tuple(worlds or ()),
        views_seed=views_seed,
        against=None if against is None else against.absolute(),
        **_size(size),
    )
    # Like Ctrl-C, so that processes started here are ended, too.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    failures = _run(settings, chosen)
    if failures:
        raise typer.Exit(1)


def _check_names(option: str, names: Iterable[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            raise typer.BadParameter(f"{option}: received {name}, expected {', '.join(known)}")


def _size(text: str) -> dict[str, int]:
    match = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if match is None:
        raise typer.BadParameter(f"--size: received {text}, expected WIDTHxHEIGHT")
    return {"width_px": int(match[1]), "height_px": int(match[2])}


def _run(settings: Settings, chosen: list[str]) -> dict[str, str]:
    """Run topics in turn, and return the reasons of those that failed."""
    console = Console()
    facts = machine()
    console.print(", ".join(f"{name} {value}" for name, value in facts.items()), highlight=False)
    by_topic: dict[str, list[Figure]] = {}
    failures: dict[str, str] = {}
    progress = TopicProgress(console, {name: _estimate_s(name, settings) for name in chosen})
    for name in chosen:
        progress.begin(name)
        try:
            by_topic[name] = TOPICS[name].run(settings, progress.say)
        except OaisysError as error:
            failures[name] = str(error)
        except Exception:  # noqa: BLE001 - the other topics' figures must not be lost
            failures[name] = traceback.format_exc()
        seconds = progress.end()
        write_results(settings, facts, by_topic, failures)
        print_table(console, f"{name}, {seconds:.0f} s", by_topic.get(name, []))
    for name, reason in failures.items():
        console.print(f"{name} failed: {reason}", style="red", markup=False, highlight=False)
    console.print(f"{settings.out / 'bench.json'}, {settings.out / 'bench.md'}", highlight=False)
    return failures


def _estimate_s(name: str, settings: Settings) -> float:
    return TOPICS[name].quick_s if settings.quick else TOPICS[name].full_s


if __name__ == "__main__":
    typer.run(main)
