"""Data sets: frames per hour, what Ray and writing cost, workers, memory."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part
from tools.bench.topics.panel import ALL
from tools.bench.worlds.dataset import VIEWS_AHEAD
from tools.bench.worlds.panel import DEMO, WORLDS

QUALITIES = ("geometry", "preview", "standard")
QUICK_QUALITIES = QUALITIES[:2]
VIEWS, QUICK_VIEWS = 30, 10
"""Views of each world."""

WORLDS_EACH, QUICK_WORLDS_EACH = 2, 1
QUICK_VIEWS_EACH = 20
"""Worlds of a data set that is timed."""

WORKERS = (1, 2)
WORLDS_FOR_WORKERS, QUICK_WORLDS_FOR_WORKERS = 4, 2

MEMORY_WORLDS, QUICK_MEMORY_WORLDS = 200, 20
MANIFEST_WORLDS, QUICK_MANIFEST_WORLDS = 1000, 50
MANIFEST_VIEWS = 100
SETTLED = 0.1
"""Share of the worlds after which a worker's memory must not grow any more."""

SHARE_PERCENT = 85.0
OVERHEAD_PERCENT = {"preview": 5.0}
GROWTH_MB = 50.0
DRIVER_MB = 500.0


class Pair(NamedTuple):
    """One world's views in a plain loop, and as a data set of one worker."""

    plain: Mapping[str, Any]
    data: Mapping[str, Any]


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return frames per hour over the panel, then the comparison of workers, then memory."""
    worlds = [DEMO] if settings.quick else list(WORLDS)
    worlds = [world for world in settings.worlds if world in WORLDS] or worlds
    qualities = QUICK_QUALITIES if settings.quick else QUALITIES
    jobs = [(world, quality) for world in worlds for quality in qualities]
    parts = len(jobs) + len(qualities) + 2
    found: dict[str, dict[str, Pair]] = {quality: {} for quality in qualities}
    for index, (world, quality) in enumerate(jobs):
        part = say_of_part(say, index, parts, world)
        found[quality][world] = _pair(settings, part, world, quality, first=index % 2)
    figures = []
    for quality, pairs in found.items():
        figures += speed_figures(ALL, quality, list(pairs.values()))
        for world, pair in pairs.items():
            figures += speed_figures(world, quality, [pair])
    figures += _encoding(found)
    for index, quality in enumerate(qualities[:2]):
        part = say_of_part(say, len(jobs) + index, parts, "workers")
        figures += _workers(settings, part, quality)
    figures += _worker_memory(settings, say_of_part(say, parts - 2, parts, "memory"))
    return [*figures, *_driver_memory(settings, say_of_part(say, parts - 1, parts, "memory"))]


def _pair(settings: Settings, say: Say, world: str, quality: str, first: int) -> Pair:
    """Measure both, in an order that alternates, because the machine's speed drifts."""
    shape: dict[str, Any] = {
        "world": world,
        "quality": quality,
        "worlds": QUICK_WORLDS_EACH if settings.quick else WORLDS_EACH,
        "views": QUICK_VIEWS_EACH if settings.quick else VIEWS,
    }
    found: dict[str, Any] = {}
    jobs = [("plain.loop", shape), ("rendering.render_dataset", {**shape, "workers": 1})]
    for index, (job, arguments) in enumerate(jobs if first == 0 else jobs[::-1]):
        part = say_of_part(say, index, len(jobs), quality)
        found[job] = run_job(f"dataset.{job}", settings, part, **arguments)
    return Pair(found["plain.loop"], found["rendering.render_dataset"])


def speed_figures(row: str, quality: str, pairs: Sequence[Pair]) -> list[Figure]:
    """Return the figures of one row; times of several worlds are added up."""
    stem = f"dataset_{row}_{quality}"
    frames = sum(pair.data["frames"] for pair in pairs)
    hours = sum(pair.data["s"] for pair in pairs) / 3600
    cores = len(os.sched_getaffinity(0))
    is_all = row == ALL
    share = Goal(SHARE_PERCENT, at_least=True) if is_all else None
    limit = OVERHEAD_PERCENT.get(quality) if is_all else None
    overhead = None if limit is None else Goal(limit)
    plain_s, data_s = (_total(pairs, key) for key in (plain_compared_s, data_compared_s))
    cpu = 100 * (_total(pairs, data_cpu_s) / _total(pairs, plain_cpu_s) - 1)
    allowed = 100 * sum(limit_s(pair.plain) for pair in pairs) / (hours * 3600)
    return [
        figure(f"{stem}_frames_per_hour", "", [frames / hours]),
        figure(f"{stem}_frames_per_core_hour", "", [frames / hours / cores]),
        figure(f"{stem}_core_hours_per_1000", "", [1000 * hours * cores / frames]),
        figure(f"{stem}_share", "%", [allowed], share, "of what batches and steady views allow"),
        figure(
            f"{stem}_overhead", "%", [100 * (data_s / plain_s - 1)], overhead, "over a plain loop"
        ),
        figure(f"{stem}_cpu_overhead", "%", [cpu], note="the same in processor time"),
        figure(f"{stem}_start_s", "s", [pair.data["start_s"] for pair in pairs]),
        figure(f"{stem}_mb_per_frame", "MB", [_total(pairs, size_mb) / frames]),
    ]


def limit_s(plain: Mapping[str, Any]) -> float:
    """Return the seconds of all batches, and of as many steady views as were rendered.

    Each world's first view is not steady: Cycles builds its scene then.
    """
    steady_s = [seconds for views in plain["sample_s"] for seconds in views[1:]]
    count = sum(map(len, plain["sample_s"]))
    return float(sum(plain["batch_s"]) + count * median(steady_s))


def plain_compared_s(pair: Pair) -> float:
    """Return the seconds of the plain loop after its first `VIEWS_AHEAD` views."""
    ahead_s = sum(pair.plain["sample_s"][0][:VIEWS_AHEAD])
    views_s = sum(map(sum, pair.plain["sample_s"])) - ahead_s
    return float(views_s + sum(pair.plain["batch_s"][1:]))


def data_compared_s(pair: Pair) -> float:
    """Return the seconds of the data set after its first `VIEWS_AHEAD` views."""
    return float(pair.data["compared_s"])


def plain_cpu_s(pair: Pair) -> float:
    """Return the processor time of the plain loop after the same views."""
    return float(pair.plain["cpu_s"])


def data_cpu_s(pair: Pair) -> float:
    """Return the processor time of the data set after the same views."""
    return float(pair.data["cpu_s"])


def size_mb(pair: Pair) -> float:
    """Return the size of the data set."""
    return float(pair.data["bytes"]) / 1e6


def _total(pairs: Sequence[Pair], value: Any) -> float:
    return float(sum(value(pair) for pair in pairs))


def _encoding(found: Mapping[str, Mapping[str, Pair]]) -> list[Figure]:
    """Return the processor time of encoding an image of each modality, in all worlds."""
    by_modality: dict[str, list[float]] = {}
    for pairs in found.values():
        for pair in pairs.values():
            for modality, seconds in pair.plain["encode_cpu_s"].items():
                by_modality.setdefault(modality, []).extend(1000 * each for each in seconds)
    return [
        figure(f"dataset_encode_{modality}_cpu_ms", "ms", values, note="of a processor core")
        for modality, values in sorted(by_modality.items())
    ]


def _workers(settings: Settings, say: Say, quality: str) -> list[Figure]:
    """Return the frames per hour of one worker and of two."""
    per_hour = {}
    for index, count in enumerate(WORKERS):
        data = run_job(
            "dataset.rendering.render_dataset",
            settings,
            say_of_part(say, index, len(WORKERS), f"{count}"),
            world=DEMO,
            quality=quality,
            worlds=QUICK_WORLDS_FOR_WORKERS if settings.quick else WORLDS_FOR_WORKERS,
            views=QUICK_VIEWS if settings.quick else VIEWS,
            workers=count,
        )
        per_hour[count] = 3600 * data["frames"] / data["s"]
    figures = [
        figure(f"dataset_workers_{count}_{quality}_frames_per_hour", "", [value])
        for count, value in per_hour.items()
    ]
    gain = per_hour[WORKERS[1]] / per_hour[WORKERS[0]]
    return [*figures, figure(f"dataset_workers_{quality}_gain", "x", [gain], note="two over one")]


def _worker_memory(settings: Settings, say: Say) -> list[Figure]:
    worlds = QUICK_MEMORY_WORLDS if settings.quick else MEMORY_WORLDS
    found_mb = run_job("dataset.plain.worker_memory", settings, say, worlds=worlds)
    return [
        figure("dataset_worker_mb", "MB", found_mb, note=f"after each of {worlds} small worlds"),
        figure("dataset_worker_growth_mb", "MB", [growth_mb(found_mb)], Goal(GROWTH_MB)),
    ]


def growth_mb(found_mb: Sequence[float]) -> float:
    """Return by how much the last tenth of the worlds exceeds the second tenth, in medians."""
    tenth = max(1, round(SETTLED * len(found_mb)))
    return median(found_mb[-tenth:]) - median(found_mb[tenth : 2 * tenth])


def _driver_memory(settings: Settings, say: Say) -> list[Figure]:
    worlds = QUICK_MANIFEST_WORLDS if settings.quick else MANIFEST_WORLDS
    found = run_job(
        "dataset.rendering.driver_memory", settings, say, worlds=worlds, views=MANIFEST_VIEWS
    )
    note = f"{worlds * MANIFEST_VIEWS:,} lines of manifests, simulated views"
    return [
        figure("dataset_driver_begun_mb", "MB", [found["begun"]]),
        figure("dataset_driver_mb", "MB", [found["peak"]], Goal(DRIVER_MB), note),
        figure("dataset_reader_mb", "MB", [found["read"]], Goal(DRIVER_MB), note),
    ]
