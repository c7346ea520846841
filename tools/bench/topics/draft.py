"""Draft: seconds over the panel's worlds, and likeness to `standard`."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part
from tools.bench.topics.panel import QUICK_VIEWS, VIEWS, choose_worlds
from tools.bench.worlds.panel import SIX_VIEWS

SECONDS, SLOWEST_SECONDS, SMALL_SECONDS = 0.25, 0.35, 0.08
PSNR_DB, SSIM, BRIGHTNESS_PERCENT = 26.0, 0.80, 5.0
SERIAL_PERCENT = 15.0

Found = Mapping[str, Any]
"""What the job ``draft.measure`` returns."""


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the figures of each world of the panel, and of all."""
    count = QUICK_VIEWS if settings.quick else VIEWS
    found = {}
    worlds = [world for world in choose_worlds(settings) if world != SIX_VIEWS]
    for index, world in enumerate(worlds):
        part = say_of_part(say, index, len(worlds), world)
        views = run_job("panel.draw_views", settings, part, world=world, count=count)
        job = {"world": world, "views": views, "rounds": settings.runs}
        found[world] = run_job("draft.measure", settings, part, **job)
    return draft_figures(found)


def draft_figures(found: Mapping[str, Found]) -> list[Figure]:
    """Return the figures of all worlds, then those of each."""
    slowest = max(found, key=lambda world: median(found[world]["draft"]["s"]))
    all_s = [s for each in found.values() for s in each["draft"]["s"]]
    small_s = [s for each in found.values() for s in each["small_s"]]
    views = [view for each in found.values() for view in each["views"]]
    off = [100 * abs(view["brightness"] - 1) for view in views]
    serial = [
        100 * alone_s / cpu_s
        for each in found.values()
        for alone_s, cpu_s in zip(each["draft"]["alone_s"], each["draft"]["cpu_s"], strict=True)
    ]
    figures = [
        figure("draft_s", "s", all_s, Goal(SECONDS)),
        figure(
            "draft_slowest_world_s",
            "s",
            found[slowest]["draft"]["s"],
            Goal(SLOWEST_SECONDS),
            f"the world {slowest}",
        ),
        figure("draft_320x240_s", "s", small_s, Goal(SMALL_SECONDS)),
        figure("draft_serial_share", "%", serial, Goal(SERIAL_PERCENT)),
        figure("draft_psnr", "dB", [v["psnr_db"] for v in views], Goal(PSNR_DB, at_least=True)),
        figure("draft_ssim", "", [v["ssim"] for v in views], Goal(SSIM, at_least=True)),
        figure("draft_brightness_off", "%", off, Goal(BRIGHTNESS_PERCENT)),
    ]
    for world, each in found.items():
        for quality in ("geometry", "draft"):
            figures += [
                figure(f"draft_{world}_{quality}_s", "s", each[quality]["s"]),
                figure(f"draft_{world}_{quality}_cpu_s", "s", each[quality]["cpu_s"]),
            ]
        figures += [
            figure(f"draft_{world}_first_s", "s", [each["first_s"]]),
            figure(f"draft_{world}_psnr", "dB", [v["psnr_db"] for v in each["views"]]),
        ]
    return figures
