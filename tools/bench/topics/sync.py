"""Time before Cycles renders when only the camera has moved."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

SHARE = 5.0


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the seconds until Cycles renders, and their share of the sample."""
    found = run_job("sync.shares", settings, say)
    pairs = list(zip(found["prepare_s"], found["all_s"], strict=True))
    note = "of samples at standard that differ in the camera's position"
    return [
        figure("camera_sync_s", "s", found["prepare_s"], note=note),
        figure("camera_sync_share", "%", [100 * s / whole for s, whole in pairs], Goal(SHARE)),
    ]
