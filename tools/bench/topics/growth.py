"""How seconds and memory grow with the image, the rocks, the triangles and the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from statistics import median
from typing import Any, NamedTuple

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

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
    """Return the points of all curves, each measured in a process of its own."""
    figures: list[Figure] = []
    points = [point for point in _points() if not settings.quick or point.x in QUICK[point.curve]]
    for index, point in enumerate(points):
        name = f"{point.curve} {point.x:,}"

        def tell(share: float, text: str, index: int = index, name: str = name) -> None:
            say((index + share) / len(points), f"{name}: {text}")

        found = run_job(
            "growth.point",
            settings,
            tell,
            changes=point.changes,
            cameras=point.cameras,
            width_px=point.width_px,
        )
        figures += _figures(point, found)
    return figures + doublings(figures)


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


def doublings(figures: Sequence[Figure]) -> list[Figure]:
    """Return by how much twice as many rocks slow a sample down, in percent."""
    by_name = {each.name: each for each in figures}
    found = []
    for few, many in DOUBLINGS:
        for quality in ("geometry", "preview"):
            pair = [by_name.get(f"rocks_{count}_{quality}_s") for count in (few, many)]
            if pair[0] is None or pair[1] is None:
                continue
            base_s = median(pair[0].values)
            slower = [100 * (value / base_s - 1) for value in pair[1].values]
            name = f"rocks_{few}_to_{many}_{quality}_slower"
            found.append(figure(name, "%", slower, Goal(DOUBLED)))
    return found
