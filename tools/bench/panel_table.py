"""The panel's figures as one table with a row for each world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tools.bench.figures import Figure

HEADINGS = (
    *("world", "n", "geometry s (ratio)", "preview s (ratio)", "standard s (ratio)"),
    *("preview PSNR dB", "preview SSIM", "preview top octave"),
    *("standard PSNR dB", "standard SSIM", "standard top octave"),
    *("batch s (ratio)", "first sample s (ratio)"),
)
COLUMNS = ((0, 1, 2, 3, 4, 11, 12), (0, 5, 6, 7, 8, 9, 10))
"""Times and likenesses as two narrower tables, by the places in `HEADINGS`."""
PREFIX = "panel_"
ROW_MARK = "_geometry_s"
COLORED = ("preview", "standard")
LIKENESS = (("psnr", 1), ("ssim", 3), ("top_octave", 2))
"""Measures and their decimals."""


def panel_rows(figures: Sequence[Figure]) -> list[list[str]]:
    """Return the cells of each row; nothing if there are no figures of the panel."""
    by_name = {each.name: each for each in figures if each.name.startswith(PREFIX)}
    worlds = [name[len(PREFIX) : -len(ROW_MARK)] for name in by_name if name.endswith(ROW_MARK)]
    return [_row(world, by_name) for world in worlds]


def _row(world: str, by_name: Mapping[str, Figure]) -> list[str]:
    stem = PREFIX + world
    cells = [world, str(len(by_name[stem + ROW_MARK].values))]
    cells += [_time(f"{stem}_{quality}", by_name) for quality in ("geometry", *COLORED)]
    for quality in COLORED:
        for measure, digits in LIKENESS:
            cells.append(_likeness(f"{stem}_{quality}_{measure}", digits, by_name))
    return [*cells, _time(f"{stem}_batch", by_name), _time(f"{stem}_first_sample", by_name)]


def _time(stem: str, by_name: Mapping[str, Figure]) -> str:
    seconds, ratio = by_name[f"{stem}_s"], by_name[f"{stem}_ratio"]
    text = f"{seconds.median:.2f} ({ratio.median:.2f})"
    beside = by_name.get(f"{stem}_to_demo")
    if beside is not None:
        text += f", {beside.median:.2f} of the demo's" + _mark(beside)
    return text


def _likeness(name: str, digits: int, by_name: Mapping[str, Figure]) -> str:
    found = by_name[name]
    text = f"{found.median:.{digits}f}" + _mark(found)
    worst = by_name.get(f"{name}_worst_view")
    if worst is not None:
        text += f", worst {worst.median:.{digits}f}" + _mark(worst)
    return text


def _mark(found: Figure) -> str:
    return " missed" if found.is_met is False else ""
