"""Colour: seconds, PSNR, SSIM and smear of presets against converged pictures of six views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tools.bench.child import run_job
from tools.bench.figures import Figure, Goal, figure
from tools.bench.settings import Say, Settings

SECONDS = {"geometry": 0.25, "preview": 1.0, "standard": 2.5, "high": 7.0}
PSNR_DB = {"preview": 36.0, "standard": 39.0, "high": 42.0}
WORST_DB = {"preview": 32.0, "standard": 36.0}


def run(settings: Settings, say: Say) -> list[Figure]:
    """Return figures of each preset over all views, then of each view."""
    rows = run_job("quality.presets", settings, say, timeout_s=4 * 3600.0)
    return [*_references(rows), *overall(rows), *by_view(rows)]


def _references(rows: list[dict[str, Any]]) -> list[Figure]:
    reused = [row["view"] for row in rows if row["is_reused"]]
    note = f"reused of an earlier run: {', '.join(reused) or 'none'}"
    return [figure("reference_s", "s", [row["reference_s"] for row in rows], note=note)]


def overall(rows: list[dict[str, Any]]) -> list[Figure]:
    """Return figures of each preset over all views."""
    figures = []
    for preset in rows[0]["presets"]:
        seconds = [s for row in rows for s in row["presets"][preset]["seconds"]]
        figures.append(figure(f"{preset}_s", "s", seconds, _goal(SECONDS, preset)))
        found = {row["view"]: row["presets"][preset] for row in rows}
        if "psnr_db" not in next(iter(found.values())):
            continue
        psnr_db = {view: each["psnr_db"] for view, each in found.items()}
        worst = min(psnr_db, key=lambda view: psnr_db[view])
        overall = figure(
            f"{preset}_psnr", "dB", psnr_db.values(), _goal(PSNR_DB, preset, at_least=True)
        )
        goal = _goal(WORST_DB, preset, at_least=True)
        note = f"the view {worst}"
        figures += [
            overall,
            figure(f"{preset}_psnr_worst_view", "dB", [psnr_db[worst]], goal, note),
            figure(f"{preset}_ssim", "", [each["ssim"] for each in found.values()]),
            figure(f"{preset}_top_octave", "", [each["top_octave"] for each in found.values()]),
        ]
    return figures


def by_view(rows: list[dict[str, Any]]) -> list[Figure]:
    """Return figures of each view and preset."""
    figures = []
    for row in rows:
        for preset, found in row["presets"].items():
            stem = f"{preset}_{row['view']}"
            figures.append(figure(f"{stem}_s", "s", found["seconds"]))
            if "psnr_db" in found:
                figures.append(figure(f"{stem}_psnr", "dB", [found["psnr_db"]]))
                figures.append(figure(f"{stem}_ssim", "", [found["ssim"]]))
                figures.append(figure(f"{stem}_top_octave", "", [found["top_octave"]]))
    return figures


def _goal(limits: dict[str, float], preset: str, *, at_least: bool = False) -> Goal | None:
    return Goal(limits[preset], at_least) if preset in limits else None


def points(figures: Sequence[Figure]) -> dict[str, tuple[float, float, float]]:
    """Return (seconds, PSNR, worst PSNR) by preset, medians over the views, for the plot."""
    by_name = {each.name: each for each in figures}
    found = {}
    for name, each in by_name.items():
        preset = name.removesuffix("_psnr")
        if name.endswith("_psnr") and f"{preset}_psnr_worst_view" in by_name:
            worst = by_name[f"{preset}_psnr_worst_view"].median
            found[preset] = (by_name[f"{preset}_s"].median, each.median, worst)
    return found
