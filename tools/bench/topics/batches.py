"""Batches: the first of a process, a new one, one on the same stage; and the first sample after."""

from __future__ import annotations

from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

# 708 x 708 points: 999,698 triangles.
MILLION: dict[str, Any] = {
    "stage": {"resolution_px": 708},
    "assets": {"rocks": [{"kind": "angular", "count": [1000, 1000]}]},
}
WORLDS: dict[str, dict[str, Any]] = {"demo": {}, "million": MILLION}
NEW_S, REUSED_S, EXTRA_S = 5.0, 1.0, 3.0


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return figures of both worlds; each value is from a process of its own."""
    figures = []
    total = len(WORLDS) * settings.runs
    for index, (world, changes) in enumerate(WORLDS.items()):
        runs = []
        for number in range(settings.runs):
            done = (index * settings.runs + number) / total

            def tell(share: float, text: str, done: float = done, world: str = world) -> None:
                say(done + share / total, f"{world}: {text}")

            runs.append(run_job("batches.batches", settings, tell, changes=changes))
        figures += _figures(world, runs)
    return figures


def _figures(world: str, runs: list[dict[str, dict[str, float]]]) -> list[Figure]:
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
