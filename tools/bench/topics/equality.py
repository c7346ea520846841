"""Depth and labels compared with Cycles' own passes, on every preset of terrain."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

LEAST_PERCENT = 99.95


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the share of pixels where all agree, of all presets and of each, and mismatches."""
    found = run_job("equality.shares", settings, say)
    equal = [percent for each in found.values() for percent in each["equal_percent"]]
    off = sum(count for each in found.values() for count in each["unequal_off_edges"])
    goal = Goal(LEAST_PERCENT, at_least=True)
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
