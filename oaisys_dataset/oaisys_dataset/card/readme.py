"""README.md of a data set: how its files are to be read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

from oaisys_core.files.markdown import escape_markdown
from oaisys_dataset.card.statistics import number_of
from oaisys_dataset.formats.base import FormatConventions

if TYPE_CHECKING:
    from oaisys_dataset.card.statistics import DatasetStatistics

TITLES = {
    "camera_axes": "Camera axes",
    "world_axes": "World axes",
    "poses": "Poses",
    "pixels": "Pixel centres",
    "depth": "Depth",
    "no_hit": "Where nothing is hit (`+inf`)",
    "labels": "Labels and ids",
    "color": "Colour",
}

BESIDE = """\
`data_card.html` shows pictures, classes and histograms; `croissant.json` is the metadata for
programs (Croissant); `frames.csv` lists the frames that are here with their cameras and poses."""


def readme_text(
    name: str,
    conventions: FormatConventions,
    statistics: DatasetStatistics,
    counts: Mapping[str, int],
    license_name: str,
) -> str:
    """Return the Markdown text of README.md.

    Args:
        name: Name of the format.
        conventions: What a reader must know.
        statistics: Of the data set.
        counts: How many of what the export wrote or left out.
        license_name: Licence of the data set; empty if the owner gave none.
    """
    splits = ", ".join(
        f"{escape_markdown(split)}: {number_of(statistics.worlds[split], 'world')}, "
        f"{number_of(frames, 'frame')}"
        for split, frames in statistics.frames.items()
    )
    told = [
        f"| {TITLES[field.name]} | {getattr(conventions, field.name)} |"
        for field in fields(conventions)
        if field.name in TITLES
    ]
    head = (
        f"# Terrain data set ({escape_markdown(name)})\n\n"
        f"Rendered by OAISYS. {splits}. Splits are by world: no world is in two of them.\n"
        f"Licence: {escape_markdown(license_name) or 'none given'}."
    )
    reading = [f"## Reading\n\n{conventions.reading}"] if conventions.reading else []
    parts = [
        head,
        BESIDE,
        f"## Files\n\n{conventions.layout}",
        *reading,
        "## Conventions\n\n| what | how |\n|---|---|\n" + "\n".join(told),
        *([_count_in_words(counts)] if counts else []),
    ]
    return "\n\n".join(parts) + "\n"


def _count_in_words(counts: Mapping[str, int]) -> str:
    rows = "\n".join(f"| {escape_markdown(what)} | {count} |" for what, count in counts.items())
    return f"## Written and left out\n\n| what | number |\n|---|---|\n{rows}"
