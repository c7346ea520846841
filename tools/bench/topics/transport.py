"""Transport of samples: to a client, to ROS subscribers, from a service call to its messages."""

from __future__ import annotations

from typing import Any, NamedTuple

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part

SAMPLES_PER_RUN = 8
LARGE_PX = (4096, 3072)
TRANSFER_MS = {"loopback": 8.0, "shared_memory": 3.0}

PUBLISH_MS, BRIDGE_CPU_MS = 60.0, 25.0
DRAFT_SECONDS = 0.3


class Way(NamedTuple):
    """One way of samples: how large, through what, and whether they are rendered."""

    size_px: tuple[int, int]
    name: str
    cached: bool
    samples: int

    @property
    def stem(self) -> str:
        """What its figures' names begin with."""
        large = "large_" if self.size_px == LARGE_PX else ""
        return f"transfer_{large}{self.name}" + ("" if self.cached else "_rendered")


def transfer(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds of a sample of the run's size and of a large one, and memory peaks."""
    small_px = (settings.width_px, settings.height_px)
    count = SAMPLES_PER_RUN * settings.runs
    ways = [Way(small_px, name, cached, count) for name in TRANSFER_MS for cached in (True, False)]
    if not settings.quick:
        ways += [Way(LARGE_PX, name, True, settings.runs) for name in TRANSFER_MS]
    figures = []
    for index, way in enumerate(ways):
        found = run_job(
            "transport.transfer.samples",
            settings,
            say_of_part(say, index, len(ways), way.stem),
            size_px=way.size_px,
            shared_memory=way.name == "shared_memory",
            cached=way.cached,
            count=way.samples,
        )
        figures += _transfer_figures(way, found)
    return figures


def _transfer_figures(way: Way, found: dict[str, Any]) -> list[Figure]:
    stem = way.stem
    size = f"{way.size_px[0]}x{way.size_px[1]}, {found['megabytes']:.1f} MB"
    what = "all at once" if way.cached else "rendered: depth and labels go ahead"
    goal = None if way.size_px == LARGE_PX else Goal(TRANSFER_MS[way.name])
    note = f"from the worker's last image to the client's arrays; {size}, {what}"
    figures = [
        figure(f"{stem}_ms", "ms", found["transfer_ms"], goal, note),
        figure(f"{stem}_overhead_ms", "ms", found["overhead_ms"], note="the call less the render"),
        figure(f"{stem}_call_ms", "ms", found["call_ms"], note="the whole call RenderSample"),
        figure(f"{stem}_stored_ms", "ms", found["stored_ms"], note="GetSample of the same"),
    ]
    peaks = [figure(f"{stem}_{p}_peak", "MB", [mb]) for p, mb in found["memory"].items()]
    return figures + peaks


def publish(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds until all messages are there, and of the bridge's processor time."""
    found = run_job("transport.ros.publishing", settings, say)
    return [
        figure(
            "publish_ms",
            "ms",
            found["publish_ms"],
            Goal(PUBLISH_MS),
            "set_pose to the last of ten messages, cloud included, less the worker's own time",
        ),
        figure(
            "publish_bridge_cpu_ms",
            "ms",
            found["cpu_ms"],
            Goal(BRIDGE_CPU_MS),
            "of the bridge's whole process a sample, receiving included",
        ),
    ]


def end_to_end(settings: Settings, say: Say) -> list[Figure]:
    """Return seconds by preset: all, the worker's share, the rest, and until depth is there."""
    figures = []
    for preset, found in run_job("transport.ros.end_to_end", settings, say).items():
        stem = f"end_to_end_{preset}"
        rest_ms = [
            1e3 * (last - render)
            for last, render in zip(found["last_s"], found["render_s"], strict=True)
        ]
        figures += [
            figure(
                f"{stem}_s",
                "s",
                found["last_s"],
                Goal(DRAFT_SECONDS) if preset == "draft" else None,
                "set_pose to the last message",
            ),
            figure(f"{stem}_render_s", "s", found["render_s"], note="of that, the worker's"),
            figure(f"{stem}_rest_ms", "ms", rest_ms, note="of that, everything else"),
            figure(f"{stem}_depth_s", "s", found["depth_s"], note="set_pose to the depth image"),
            figure(f"{stem}_answer_s", "s", found["answer_s"], note="set_pose to its answer"),
        ]
    return figures
