"""The panel: times and quality of random views of eight worlds, as ratios to a frozen scene's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part
from tools.bench.topics import against
from tools.bench.worlds.panel import DEMO, QUICK_WORLDS, SIX_VIEWS, WORLDS

VIEWS, QUICK_VIEWS = 3, 2
TIMEOUT_S = 4 * 3600.0

ALL = "all"
"""Row of the worlds together, without the six views."""
TIMED = ("batch", "first_sample", "geometry", "preview", "standard")
COLORED = ("preview", "standard")
LIKENESS = {"psnr_db": ("psnr", "dB"), "ssim": ("ssim", ""), "top_octave": ("top_octave", "")}
"""Name and unit of each measure of likeness to the reference."""

PSNR_DB = {"preview": 38.0, "standard": 40.0}
WORST_DB = {"preview": 35.0, "standard": 37.0}
TOP_OCTAVE = {"preview": (0.8, 1.15), "standard": (0.9, 1.1)}
"""Least and largest share of the finest texture that a quality may keep in any world."""
DEMOS = 1.2
"""Most that a sample of `COMPARED` may take, in those of the demo's world."""
COMPARED = ("stage_canyon", "assets_vegetation")

Found = Mapping[str, Any]
"""What the job ``panel.measure`` returns."""


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return figures of each world and of all, or the comparison with another checkout."""
    worlds = choose_worlds(settings)
    if settings.against is not None:
        count = QUICK_VIEWS if settings.quick else VIEWS
        return against.compare(settings, say, [w for w in worlds if w != SIX_VIEWS], count)
    found = {
        world: _measure(settings, say_of_part(say, index, len(worlds), world), world)
        for index, world in enumerate(worlds)
    }
    return panel_figures(found)


def choose_worlds(settings: Settings) -> list[str]:
    """Return the names of the worlds of a run, the six views' last."""
    if settings.worlds:
        return list(settings.worlds)
    return list(QUICK_WORLDS) if settings.quick else [*WORLDS, SIX_VIEWS]


def _measure(settings: Settings, say: Say, world: str) -> dict[str, Any]:
    count = QUICK_VIEWS if settings.quick else VIEWS
    views = run_job("panel.draw_views", settings, say, world=world, count=count)
    found: dict[str, Any] = run_job(
        "panel.measure",
        settings,
        say,
        timeout_s=TIMEOUT_S,
        world=world,
        views=views,
        rounds=settings.runs,
        with_references=True,
    )
    return found


def panel_figures(found: Mapping[str, Found]) -> list[Figure]:
    """Return the figures of all worlds, then those of each."""
    panel = {world: each for world, each in found.items() if world != SIX_VIEWS}
    figures = [*_of(ALL, list(panel.values())), *_worst(panel), *_octaves(panel)] if panel else []
    figures += _beside_the_demo(panel)
    for world, each in found.items():
        figures += _of(world, [each])
    return [*figures, *_conditions(list(found.values()))]


def _conditions(found: Sequence[Found]) -> list[Figure]:
    """Return the times of references and of calibrations."""
    calibration_s = [
        seconds
        for each in found
        for quality in COLORED
        for seconds in each[quality]["calibration_s"]
    ]
    judged = [view for each in found for view in each[COLORED[0]]["views"]]
    reused = f"reused of an earlier run: {sum(view['is_reused'] for view in judged)}"
    reference_s = [view["reference_s"] for view in judged]
    note = "the frozen scene that ratios are to"
    devices = ", ".join(sorted({each["device"] for each in found}))
    return [
        figure("panel_reference_s", "s", reference_s, note=reused),
        figure("panel_calibration_s", "s", calibration_s, note=f"{note}; {devices}"),
    ]


def _of(row: str, found: Sequence[Found]) -> list[Figure]:
    """Return the figures of one row of the panel's table."""
    figures = []
    for kind in TIMED:
        stem = f"panel_{row}_{kind}"
        note = "calibrations that it takes" if row == ALL else ""
        figures += [
            figure(f"{stem}_s", "s", _values(found, kind, "s")),
            figure(f"{stem}_ratio", "x", _values(found, kind, "ratio"), note=note),
        ]
    for quality in COLORED:
        views = [view for each in found for view in each[quality]["views"]]
        for measure, (name, unit) in LIKENESS.items():
            goal = None
            if row == ALL and measure == "psnr_db":
                goal = Goal(PSNR_DB[quality], at_least=True)
            values = [view[measure] for view in views]
            figures.append(figure(f"panel_{row}_{quality}_{name}", unit, values, goal))
    return figures


def _values(found: Sequence[Found], kind: str, unit: str) -> list[float]:
    return [value for each in found for value in each[kind][unit]]


def _worst(panel: Mapping[str, Found]) -> list[Figure]:
    """Return the PSNR of the worst view of all worlds."""
    figures = []
    for quality in COLORED:
        by_view = {
            f"{world} {index}": view["psnr_db"]
            for world, each in panel.items()
            for index, view in enumerate(each[quality]["views"])
        }
        worst = min(by_view, key=lambda view: by_view[view])
        goal = Goal(WORST_DB[quality], at_least=True)
        name = f"panel_{ALL}_{quality}_psnr_worst_view"
        figures.append(figure(name, "dB", [by_view[worst]], goal, f"the view {worst}"))
    return figures


def _octaves(panel: Mapping[str, Found]) -> list[Figure]:
    """Return the least and the largest of the worlds' medians of each quality's top octave."""
    return [figure for quality in TOP_OCTAVE for figure in _octaves_of(panel, quality)]


def _octaves_of(panel: Mapping[str, Found], quality: str) -> list[Figure]:
    kept = {
        world: median(view["top_octave"] for view in each[quality]["views"])
        for world, each in panel.items()
    }
    figures = []
    for name, pick, limit in zip(("least", "most"), (min, max), TOP_OCTAVE[quality], strict=True):
        world = pick(kept, key=lambda world: kept[world])
        goal = Goal(limit, at_least=name == "least")
        stem = f"panel_{ALL}_{quality}_top_octave_{name}"
        figures.append(figure(stem, "", [kept[world]], goal, f"the world {world}"))
    return figures


def _beside_the_demo(panel: Mapping[str, Found]) -> list[Figure]:
    """Return how many times longer samples of some worlds take than the demo's.

    They are compared by their ratios to the calibration, because the machine's speed drifts.
    """
    if DEMO not in panel:
        return []
    figures = []
    for world in COMPARED:
        for quality in COLORED if world in panel else ():
            ours, demos = (
                figure(each, "x", panel[each][quality]["ratio"]).median for each in (world, DEMO)
            )
            name = f"panel_{world}_{quality}_to_demo"
            figures.append(figure(name, "x", [ours / demos], Goal(DEMOS), "of medians"))
    return figures
