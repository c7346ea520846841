"""Choosing the next view: scoring 200 candidates, all of the planner's work, taking a view in."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

LIMITS_MS = {"score_200_ms": 1000.0}
NOTES = {
    "score_200_ms": "200 views of a half explored hill, 50 cm voxels, 20 m of depth",
    "next_view_ms": "all of it: candidates, ways to them, scores",
    "take_in_ms": "one view into the map that plans are made on",
}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds, the scores' with their goal."""
    found = run_job("planning.next_view", settings, say)
    return [figure(name, "ms", values, _goal(name), NOTES[name]) for name, values in found.items()]


def _goal(name: str) -> Goal | None:
    return Goal(LIMITS_MS[name]) if name in LIMITS_MS else None
