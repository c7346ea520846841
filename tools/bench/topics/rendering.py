"""Rendering: batches, moved cameras, time budgets, the plain way, equality with Cycles' passes."""

from __future__ import annotations

from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure, ratio
from tools.bench.settings import Say, Settings, say_of_part

# 708 x 708 points: 999,698 triangles.
MILLION: dict[str, Any] = {
    "stage": {"resolution_px": 708},
    "assets": {"rocks": [{"kind": "angular", "count": [1000, 1000]}]},
}
WORLDS: dict[str, dict[str, Any]] = {"demo": {}, "million": MILLION}
NEW_S, REUSED_S, EXTRA_S = 5.0, 1.0, 3.0

PREPARE_PERCENT = 5.0

BUDGETS_S = [1.0, 2.0, 4.0]
WITHIN = 15.0

MIN_PERCENT = 99.95


def batches(settings: Settings, say: Say) -> list[Figure]:
    """Return figures of both worlds; each value is from a process of its own."""
    figures = []
    parts = len(WORLDS) * settings.runs
    for index, (world, changes) in enumerate(WORLDS.items()):
        runs = []
        for number in range(settings.runs):
            tell = say_of_part(say, index * settings.runs + number, parts, world)
            runs.append(run_job("samples.batches", settings, tell, changes=changes))
        figures += _batch_figures(world, runs)
    return figures


def _batch_figures(world: str, runs: list[dict[str, dict[str, float]]]) -> list[Figure]:
    limits = {"first": None, "second": NEW_S, "reused": REUSED_S} if world == "million" else {}
    figures = []
    for kind in runs[0]:
        limit = limits.get(kind)
        figures += [
            figure(
                f"batch_{world}_{kind}_s",
                "s",
                [run[kind]["batch_s"] for run in runs],
                None if limit is None else Goal(limit),
            ),
            figure(
                f"first_sample_extra_{world}_{kind}_s",
                "s",
                [run[kind]["first_sample_extra_s"] for run in runs],
                Goal(EXTRA_S),
                "beyond a steady one of the same quality, standard",
            ),
        ]
    return figures


def sync(settings: Settings, say: Say) -> list[Figure]:
    """Return the seconds until Cycles renders, and their share of the sample."""
    found = run_job("samples.preparation", settings, say)
    shares = [100 * s / whole for s, whole in zip(found["prepare_s"], found["all_s"], strict=True)]
    note = "of samples at standard that differ in the camera's position"
    return [
        figure("camera_sync_s", "s", found["prepare_s"], note=note),
        figure(
            "camera_sync_share",
            "%",
            shares,
            Goal(PREPARE_PERCENT),
        ),
    ]


def budget(settings: Settings, say: Say) -> list[Figure]:
    """Return seconds of each budget, and the largest deviation from it."""
    found = run_job("samples.time_by_budget", settings, say, budgets_s=BUDGETS_S)
    figures = []
    for budget_s, seconds in zip(BUDGETS_S, found, strict=True):
        stem = f"budget_{budget_s:g}"
        off = [100 * abs(each - budget_s) / budget_s for each in seconds]
        held = f"{sum(each <= WITHIN for each in off)} of {len(off)} views within {WITHIN:g} %"
        figures += [
            figure(f"{stem}_s", "s", seconds),
            figure(f"{stem}_off", "%", off, note=held),
            figure(f"{stem}_off_most", "%", [max(off)], Goal(WITHIN)),
        ]
    return figures


def plain(settings: Settings, say: Say) -> list[Figure]:
    """Return what the plain renders take, and the ratios; both measured in one process."""
    found = run_job("plain.against_presets", settings, say)
    note = f"{found['samples']} samples per pixel"
    views = found["views"]
    figures = [
        figure(f"plain_{kind}_s", "s", [view[kind] for view in views], note=note)
        for kind in views[0]
    ]
    totals = [sum(view.values()) for view in views]
    figures.append(figure("plain_s", "s", totals, note=f"all of them, {note}"))
    for preset, seconds in found["presets"].items():
        figures.append(figure(f"beside_plain_{preset}_s", "s", seconds))
        # No goal: whatever makes samples cheaper makes the plain way cheaper, too.
        figures.append(ratio(f"speedup_{preset}", totals, seconds, None))
    return figures


def equality(settings: Settings, say: Say) -> list[Figure]:
    """Return the share of pixels where all agree, of all presets and of each, and mismatches."""
    found = run_job("equality.shares", settings, say)
    equal = [percent for each in found.values() for percent in each["equal_percent"]]
    off = sum(count for each in found.values() for count in each["unequal_off_edges"])
    goal = Goal(MIN_PERCENT, at_least=True)
    note = "of depth, semantic_0 and instance together"
    return [
        figure("equal_pixels", "%", equal, goal, note),
        figure("equal_pixels_least", "%", [min(equal)], goal),
        figure("unequal_pixels_off_edges", "", [off], Goal(0)),
        *(
            figure(f"equal_pixels_{preset}", "%", each["equal_percent"], goal)
            for preset, each in found.items()
        ),
    ]
