"""Samples from the worker to a client: over loopback and by shared memory."""

from __future__ import annotations

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

SAMPLES_PER_RUN = 8
LARGE_PX = (4096, 3072)
LIMITS_MS = {"loopback": 8.0, "shared_memory": 3.0}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return milliseconds of a sample of the run's size and of a large one, and memory peaks."""
    figures = []
    small_px = (settings.width_px, settings.height_px)
    sizes = [("", small_px, SAMPLES_PER_RUN * settings.runs)]
    if not settings.quick:
        sizes.append(("large_", LARGE_PX, settings.runs))
    ways = [(*size, way) for size in sizes for way in LIMITS_MS]
    for index, (prefix, size_px, count, way) in enumerate(ways):

        def tell(share: float, text: str, index: int = index, way: str = way) -> None:
            say((index + share) / len(ways), f"{way}: {text}")

        found = run_job(
            "transfer.samples",
            settings,
            tell,
            size_px=size_px,
            shared_memory=way == "shared_memory",
            count=count,
        )
        stem = f"transfer_{prefix}{way}"
        note = f"{size_px[0]}x{size_px[1]}: {found['megabytes']:.1f} MB"
        goal = None if prefix else Goal(LIMITS_MS[way])
        figures += [
            figure(f"{stem}_ms", "ms", found["transfer_ms"], goal, note),
            figure(f"{stem}_call_ms", "ms", found["call_ms"], note="the whole call RenderSample"),
            figure(f"{stem}_stored_ms", "ms", found["stored_ms"], note="GetSample of the same"),
        ]
        figures += [
            figure(f"{stem}_{process}_peak", "MB", [peak])
            for process, peak in found["memory"].items()
        ]
    return figures
