"""Plots of the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes

mpl.use("Agg")
from matplotlib import pyplot as plt

from tools.bench.figures import Figure

DPI = 110
AXES = {
    "size": "pixels of the image",
    "rocks": "rocks",
    "stage": "triangles of the stage",
    "cameras": "cameras",
}


def plot_quality(points: Mapping[str, tuple[float, float, float]], path: Path) -> Path:
    """Draw quality against time and return the file.

    Args:
        points: (seconds, PSNR in dB of the median view, of the worst) by preset.
        path: Of the picture.
    """
    shown, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    ordered = sorted(points.items(), key=lambda item: item[1][0])
    seconds = [point[0] for _, point in ordered]
    axes.plot(seconds, [point[1] for _, point in ordered], "o-", label="median of the views")
    axes.plot(seconds, [point[2] for _, point in ordered], "v--", label="worst view")
    for name, (x, y, _) in ordered:
        axes.annotate(name, (x, y), textcoords="offset points", xytext=(6, 6))
    axes.set(xscale="log", xlabel="seconds per sample (all modalities)", ylabel="PSNR in dB")
    for set_formatter in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        set_formatter("{x:g}")
    axes.margins(x=0.12, y=0.1)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    shown.savefig(path, dpi=DPI)
    plt.close(shown)
    return path


def plot_growth(figures: Sequence[Figure], path: Path) -> Path:
    """Draw the growth curves, seconds to the left and memory to the right; return the file."""
    names = [name for name in AXES if any(figure.curve == name for figure in figures)]
    shown, grid = plt.subplots(
        1, len(names), figsize=(4.4 * len(names), 4.2), layout="constrained", squeeze=False
    )
    for axes, name in zip(grid[0], names, strict=True):
        _draw_curve(axes, name, [figure for figure in figures if figure.curve == name])
    grid[0][0].set_ylabel("seconds")
    path.parent.mkdir(parents=True, exist_ok=True)
    shown.savefig(path, dpi=DPI)
    plt.close(shown)
    return path


def _draw_curve(axes: Axes, name: str, figures: Sequence[Figure]) -> None:
    memory = axes.twinx()
    kinds = dict.fromkeys(kind_of(figure) for figure in figures)
    for kind in kinds:
        points = sorted((f.x, f.median) for f in figures if kind_of(f) == kind)
        target, style = (memory, "k:") if kind == "peak memory" else (axes, "o-")
        target.plot([x for x, _ in points], [y for _, y in points], style, label=kind)
    axes.set(xlabel=AXES[name], yscale="log")
    if name == "cameras":
        axes.set_xticks(sorted({figure.x for figure in figures}))
    elif name == "rocks":
        # From none on.
        axes.set_xscale("symlog", linthresh=1000.0)
        axes.set_xlim(left=-100.0)
    else:
        axes.set_xscale("log")
    memory.set_ylabel("peak memory in MB (dotted)")
    memory.set_ylim(bottom=0)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc="center left", fontsize="small")


def kind_of(figure: Figure) -> str:
    """Return what a point of a growth curve is about."""
    for kind in ("geometry", "preview", "build"):
        if figure.name.endswith(f"_{kind}_s"):
            return kind
    return "peak memory"
