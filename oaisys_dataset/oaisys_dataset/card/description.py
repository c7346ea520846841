"""All files that describe a data set: README.md, frames.csv, croissant.json, data_card.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from oaisys_core.errors import InvalidInputError
from oaisys_dataset.card import own_conventions
from oaisys_dataset.card.croissant import CROISSANT, croissant_text
from oaisys_dataset.card.data_card import data_card
from oaisys_dataset.card.frames_table import FRAMES, frames_table
from oaisys_dataset.card.readme import readme_text
from oaisys_dataset.card.statistics import sample_indices, statistics_of
from oaisys_dataset.formats.base import ExportOptions, FormatConventions, label_names

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset

README, DATA_CARD = "README.md", "data_card.html"

PICTURES = 12
"""Frames on the sheet of a data card."""


def describe_dataset(dataset: Dataset, options: ExportOptions) -> list[str]:
    """Write the files that describe a data set into the data set itself; return their names.

    Raises:
        InvalidInputError: The data set has no frame.
        RenderError: They could not be written.
    """
    if not len(dataset):
        raise InvalidInputError("dataset", dataset.place.url, "at least one frame")
    files = description_files(
        dataset, own_conventions.NAME, own_conventions.CONVENTIONS, {}, options
    )
    for name, data in files.items():
        dataset.place.write(name, data)
    return list(files)


def description_files(
    dataset: Dataset,
    name: str,
    conventions: FormatConventions,
    counts: Mapping[str, int],
    options: ExportOptions,
    needed: Sequence[str] = (),
    *,
    has_scans: bool = True,
) -> dict[str, bytes]:
    """Return the content of each file by its name.

    Args:
        dataset: What is described.
        name: Name of the format.
        conventions: What a reader must know.
        counts: How many of what an export wrote or left out; empty for the data set itself.
        options: Licence and price.
        needed: Images without which an export leaves a frame out, so that these files do, too.
        has_scans: Whether an export holds the lidar scans.
    """
    wanted = set(needed)
    kept = [i for i, record in enumerate(dataset.records) if wanted <= set(record.images)]
    statistics = statistics_of(dataset, kept, has_scans=has_scans)
    license_name = options.license
    readme = readme_text(name, conventions, statistics, counts, license_name)
    frames = frames_table(dataset.records[index] for index in kept)
    shown = [dataset[kept[place]] for place in sample_indices(len(kept), PICTURES)]
    label_ids = {label: label_id for label_id, label in label_names(dataset).items()}
    page = data_card(name, statistics, shown, label_ids, license_name, options.price_per_hour)
    return {
        README: readme.encode(),
        FRAMES: frames,
        CROISSANT: croissant_text(name, statistics, frames, license_name).encode(),
        DATA_CARD: page.encode(),
    }
