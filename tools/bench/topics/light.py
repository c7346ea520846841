"""Mitsuba judges our radiance on the true meshes of small worlds, with the same law and light.

The audit of light (``oaisys audit --light``) compares patches with formulas; this compares
landscapes, with shadows and light that the ground throws back, with a renderer that others wrote.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part

MEAN_PERCENT, P95_PERCENT = 2.0, 4.0
"""Largest error of the mean, and 95th percentile of the pixels' errors."""
RENDERERS = {"cycles": ("blender", "audit"), "draft": ("analytic", "draft")}
RUNS = (
    ("craters", "cycles"),
    ("craters", "draft"),
    ("rocks", "cycles"),
    ("rocks", "draft"),
    ("hapke", "cycles"),
    ("hapke_bounces", "cycles"),
    ("hapke_bounces", "draft"),
)
"""Worlds of `tools.bench.jobs.light` and renderers. A draft always has light of the ground nearby,
so there is no draft of the world without bounces."""


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the figures of all worlds."""
    figures: list[Figure] = []
    for i, (world, renderer) in enumerate(RUNS):
        part = say_of_part(say, i, len(RUNS), f"{world} {renderer}")
        backend, quality = RENDERERS[renderer]
        job: dict[str, Any] = {"world": world, "backend": backend, "quality": quality}
        found = run_job("light.compare", settings, part, **job)
        figures += light_figures(f"light_{world}_{renderer}", found)
    return figures


def light_figures(start: str, found: Mapping[str, float]) -> list[Figure]:
    """Return the figures of one world and renderer, with their goals.

    Args:
        start: Of their names.
        found: What the job returns.
    """
    note = f"{found['mean']:+.2%}; {found['share']:.0%} of the pixels are off edges"
    return [
        figure(f"{start}_mean", "%", [abs(found["mean"]) * 100], Goal(MEAN_PERCENT), note),
        figure(
            f"{start}_p95",
            "%",
            [found["p95"] * 100],
            Goal(P95_PERCENT),
            f"{found['sun_p95']:.2%} where the sun shines",
        ),
    ]
