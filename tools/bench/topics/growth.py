"""Growth of time and memory with image size, rocks, triangles and cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any, NamedTuple

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings, say_of_part

WIDTHS_PX = (160, 320, 640, 1280, 1920)
ROCKS = (0, 1_000, 2_000, 10_000, 20_000, 50_000, 100_000)
TRIANGLES = (100_000, 500_000, 1_000_000, 2_000_000, 4_000_000, 8_000_000, 16_000_000)
CAMERAS = (1, 2, 3, 4)
QUICK = {
    "size": [width * width * 3 // 4 for width in WIDTHS_PX[:3]],
    "rocks": (0, *ROCKS[1:3]),
    "stage": TRIANGLES[:2],
    "cameras": CAMERAS[:2],
}
DOUBLINGS = ((1_000, 2_000), (10_000, 20_000), (50_000, 100_000))
DOUBLED = 10.0
KINDS = ("angular", "rounded", "slab", "boulder")


class Point(NamedTuple):
    """One world of a curve; ``x`` is what grows."""

    curve: str
    x: int
    changes: dict[str, Any]
    cameras: int = 1
    width_px: int = 640


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return the points of all curves, each measured in a process of its own, and doublings."""
    figures: list[Figure] = []
    points = [point for point in _points() if not settings.quick or point.x in QUICK[point.curve]]
    pairs = DOUBLINGS[:1] if settings.quick else DOUBLINGS
    jobs = len(points) + len(pairs)

    for index, point in enumerate(points):
        found = run_job(
            "growth.point",
            settings,
            say_of_part(say, index, jobs, f"{point.curve} {point.x:,}"),
            changes=point.changes,
            cameras=point.cameras,
            width_px=point.width_px,
        )
        figures += _figures(point, found)
    for index, (few, many) in enumerate(pairs, len(points)):
        turns = run_job(
            "growth.in_turns",
            settings,
            say_of_part(say, index, jobs, f"rocks {few:,} and {many:,}"),
            worlds=[{"assets": {"rocks": _rocks(count)}} for count in (few, many)],
        )
        figures += slower(few, many, turns)
    return figures


def slower(few: int, many: int, turns: Sequence[Mapping[str, Sequence[float]]]) -> list[Figure]:
    """Return by how many percent many rocks slow a sample down, turn by turn.

    Args:
        few, many: Rocks.
        turns: Seconds with few and with many, by quality.
    """
    by_quality = {
        quality: [100 * (turn[quality][1] / turn[quality][0] - 1) for turn in turns]
        for quality in turns[0]
    }
    return [
        figure(f"rocks_{few}_to_{many}_{quality}_slower", "%", values, Goal(DOUBLED))
        for quality, values in by_quality.items()
    ]


def _points() -> list[Point]:
    return [
        *(Point("size", width * width * 3 // 4, {}, width_px=width) for width in WIDTHS_PX),
        *(Point("rocks", count, {"assets": {"rocks": _rocks(count)}}) for count in ROCKS),
        *(Point("stage", count, _stage(count)) for count in TRIANGLES),
        *(Point("cameras", count, {}, cameras=count) for count in CAMERAS),
    ]


def _rocks(count: int) -> list[dict[str, Any]]:
    """Return groups of the demo's kinds, together ``count`` rocks."""
    each = count // len(KINDS)
    return [{"kind": kind, "count": [each, each], "size_m": [0.1, 0.6]} for kind in KINDS]


def _stage(triangles: int) -> dict[str, Any]:
    return {"stage": {"resolution_px": round(sqrt(triangles / 2)) + 1}}


def _figures(point: Point, found: dict[str, list[float]]) -> list[Figure]:
    stem = f"{point.curve}_{point.x}"
    figures = []
    for kind, values in found.items():
        name, unit = (f"{stem}_memory", "MB") if kind == "memory" else (f"{stem}_{kind}_s", "s")
        figures.append(Figure(name, unit, tuple(values), curve=point.curve, x=point.x))
    return figures
