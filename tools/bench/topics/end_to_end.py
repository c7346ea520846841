"""Time from the service call to the last message, and the share of rendering."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, figure
from tools.bench.settings import Say, Settings


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return seconds by preset: all, the worker's share, the rest, and until depth is there."""
    figures = []
    for preset, found in run_job("ros.end_to_end", settings, say).items():
        stem = f"end_to_end_{preset}"
        rest_ms = [
            1e3 * (last - render)
            for last, render in zip(found["last_s"], found["render_s"], strict=True)
        ]
        figures += [
            figure(f"{stem}_s", "s", found["last_s"], note="set_pose to the last message"),
            figure(f"{stem}_render_s", "s", found["render_s"], note="of that, the worker's"),
            figure(f"{stem}_rest_ms", "ms", rest_ms, note="of that, everything else"),
            figure(f"{stem}_depth_s", "s", found["depth_s"], note="set_pose to the depth image"),
            figure(f"{stem}_answer_s", "s", found["answer_s"], note="set_pose to its answer"),
        ]
    return figures
