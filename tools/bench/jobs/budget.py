"""Times of samples with a time budget."""

from __future__ import annotations

from tools.bench.jobs.world import Observer, simulation_of, world_config
from tools.bench.settings import Say, Settings
from tools.bench.views import random_poses

VIEWS, QUICK_VIEWS = 20, 5
WARM_UP_VIEWS = 3
"""Views from which the backend learns what samples cost."""


def seconds(settings: Settings, say: Say, budgets_s: list[float]) -> list[list[float]]:
    """Return, by budget, the seconds of samples at random views."""
    count = QUICK_VIEWS if settings.quick else VIEWS
    found: list[list[float]] = []
    with simulation_of(world_config(settings)) as simulation:
        simulation.step_batch()
        observer = Observer(simulation)
        extent_m = simulation.info().stage_extent_m
        assert extent_m is not None
        poses = random_poses(WARM_UP_VIEWS + count, extent_m, observer.heights_m)
        for index, budget_s in enumerate(budgets_s):
            say(index / len(budgets_s), f"{count} random views in {budget_s:g} s each")
            # With the best preset, only the budget limits the samples.
            render = {"quality": "final", "time_budget_s": budget_s}
            took_s = [observer.sample(pose, render)[0] for pose in poses]
            found.append(took_s[WARM_UP_VIEWS:])
    return found
