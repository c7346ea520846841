"""The panel's times beside those of another checkout, in alternating runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

from tools.bench.child import CORE, run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.references import Image, psnr_db
from tools.bench.settings import Say, Settings, say_of_part

ROUNDS = 2
"""Timed samples of each view and quality in a process."""

TIMED = ("batch", "first_sample", "geometry", "preview", "standard")
JUDGED = {"geometry": 1.0, "preview": 0.7, "standard": 0.7}
"""Goals over the panel, as shares of the other checkout's seconds; no world may be slower."""
COLORED = ("preview", "standard")

EQUAL_DB = 100.0

OURS, OTHERS = "ours", "others"

Runs = Mapping[str, Sequence[Mapping[str, Any]]]
"""What the job ``panel.measure`` returned in each turn, for `OURS` and `OTHERS`."""


def compare(settings: Settings, say: Say, worlds: Sequence[str], views: int) -> list[Figure]:
    """Return ratios of our medians to the other checkout's, by world and over the panel.

    Both checkouts render the same views of this checkout's worlds with this environment's
    interpreter, one process each per world and turn.

    Raises:
        ValueError: The folder is no checkout.
    """
    checkout = settings.against
    assert checkout is not None
    if not (checkout / CORE / CORE / "simulation.py").is_file():
        raise ValueError(f"--against: received {checkout}, expected the root of a checkout")
    found = {
        world: _in_turns(settings, say_of_part(say, index, len(worlds), world), world, views)
        for index, world in enumerate(worlds)
    }
    return comparison_figures(found)


def _in_turns(
    settings: Settings, say: Say, world: str, count: int
) -> dict[str, list[dict[str, Any]]]:
    views = run_job("panel.draw_views", settings, say, world=world, count=count)
    sides: dict[str, Path | None] = {OURS: None, OTHERS: settings.against}
    found: dict[str, list[dict[str, Any]]] = {side: [] for side in sides}
    for turn in range(settings.runs):
        # Every other turn is reversed, so that a steady drift of the machine's speed cancels out.
        order = list(sides)[:: 1 if turn % 2 == 0 else -1]
        for place, side in enumerate(order):
            part = say_of_part(say, 2 * turn + place, 2 * settings.runs, f"turn {turn + 1}, {side}")
            result = run_job(
                "panel.measure",
                settings,
                part,
                core_of=sides[side],
                world=world,
                views=views,
                rounds=ROUNDS,
                with_references=False,
                checkout=str(sides[side] or ""),
            )
            found[side].append(result)
    return found


def comparison_figures(found: Mapping[str, Runs]) -> list[Figure]:
    """Return the ratios over the panel, then those of each world with what has changed."""
    panel: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for runs in found.values():
        for side, each in runs.items():
            panel[side] += each
    figures = [_ratio("all", kind, panel, JUDGED.get(kind)) for kind in TIMED]
    for world, runs in found.items():
        slowest = dict.fromkeys(JUDGED, 1.0)
        figures += [_ratio(world, kind, runs, slowest.get(kind)) for kind in TIMED]
        figures += _changes(world, runs)
    return figures


def _ratio(row: str, kind: str, runs: Runs, limit: float | None) -> Figure:
    """Return the ratio of the medians of all values, and with the machine's speed divided out."""
    seconds, calibrated = (
        {side: [v for run in runs[side] for v in run[kind][unit]] for side in (OURS, OTHERS)}
        for unit in ("s", "ratio")
    )
    ours_s, others_s = median(seconds[OURS]), median(seconds[OTHERS])
    by_speed = median(calibrated[OURS]) / median(calibrated[OTHERS])
    note = (
        f"{ours_s:.3f} s (n = {len(seconds[OURS])}) to {others_s:.3f} s "
        f"(n = {len(seconds[OTHERS])}); {by_speed:.3f} by ratios to the calibration"
    )
    goal = None if limit is None else Goal(limit)
    return figure(f"against_{row}_{kind}", "x", [ours_s / others_s], goal, note)


def _changes(world: str, runs: Runs) -> list[Figure]:
    """Return in how many views depth and labels differ, and how alike the pictures are."""
    ours, others = runs[OURS][-1], runs[OTHERS][-1]
    unequal = sum(
        a != b for a, b in zip(ours["geometry_sha256"], others["geometry_sha256"], strict=True)
    )
    note = f"of {len(ours['geometry_sha256'])} views: depth or a kind of label has other bytes"
    figures = [figure(f"against_{world}_unequal_views", "", [unequal], Goal(0), note)]
    for quality in COLORED:
        pairs = zip(ours[quality]["views"], others[quality]["views"], strict=True)
        likeness = [min(EQUAL_DB, psnr_db(*map(_picture, pair))) for pair in pairs]
        note = f"of one's pictures against the other's, noise of both; {EQUAL_DB:g} where equal"
        figures.append(figure(f"against_{world}_{quality}_psnr", "dB", likeness, note=note))
    return figures


def _picture(view: Mapping[str, Any]) -> Image:
    image = cv2.imread(view["picture"], cv2.IMREAD_COLOR)
    if image is None:
        raise OSError(f"cannot read {view['picture']}")
    return np.asarray(image, np.uint8)
