"""Deviation from time budgets on random views."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

BUDGETS_S = [1.0, 2.0, 4.0]
WITHIN = 15.0


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return seconds of each budget, and the largest deviation from it."""
    found = run_job("budget.seconds", settings, say, budgets_s=BUDGETS_S)
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
