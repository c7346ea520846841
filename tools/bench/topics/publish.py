"""From the worker's finished frames to a subscriber in another process."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

WHOLE_MS, CPU_MS = 60.0, 25.0


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds until all messages are there, and of the bridge's processor time."""
    found = run_job("ros.publishing", settings, say)
    return [
        figure(
            "publish_ms",
            "ms",
            found["publish_ms"],
            Goal(WHOLE_MS),
            "set_pose to the last of ten messages, cloud included, less the worker's own time",
        ),
        figure(
            "publish_bridge_cpu_ms",
            "ms",
            found["cpu_ms"],
            Goal(CPU_MS),
            "of the bridge's whole process a sample, receiving included",
        ),
    ]
