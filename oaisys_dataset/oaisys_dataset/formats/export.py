"""The export of a data set in a format, with all that describes it."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_core.errors import ConfigError, InvalidInputError, RenderError, one_of
from oaisys_core.files.whole_files import whole_folder
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_dataset.card.description import README, description_files
from oaisys_dataset.formats.base import (
    FRAMES_WITHOUT,
    LEFT_OUT_SCANS,
    WRITTEN_SCANS,
    DatasetFormat,
    ExportOptions,
    check_suits,
    format_named,
    frames_without_images,
    modality_names,
)
from oaisys_dataset.places import StoragePlace, open_place
from oaisys_dataset.shards import HEAD

if TYPE_CHECKING:
    from oaisys_dataset.reader import Dataset


def export_dataset(
    dataset: Dataset, name: str, target: str | Path, options: ExportOptions | None = None
) -> Mapping[str, int]:
    """Write a data set in a format.

    A folder appears when everything is written. At a URL, README.md is written last.

    Args:
        dataset: What is written.
        name: Name of the format.
        target: A folder or URL with nothing in it.
        options: The caller's choices.

    Returns:
        How many of what were written or left out.

    Raises:
        InvalidInputError: The format, a setting, the folder or the data set does not suit.
        RenderError: It could not be written, or no frame has what the format needs; nothing is
            left.
        ConfigError: A package is missing that the format needs.
    """
    options = options or ExportOptions()
    chosen = format_named(name)
    place = open_place(target)
    _check(chosen, dataset, place, options)
    try:
        with _write_folder(place) as part:
            counts = dict(chosen.write(dataset, part, options))
            if len(dataset.scans) and not chosen.writes_scans:
                counts[LEFT_OUT_SCANS] = len(dataset.scans)
            needed = chosen.images_needed(options)
            counts |= _count_missing(chosen, dataset, needed)
            _require_content(name, dataset, counts)
            described = description_files(
                dataset,
                name,
                chosen.conventions,
                counts,
                options,
                needed,
                has_scans=chosen.writes_scans,
            )
            for file, data in described.items():
                (part / file).write_bytes(data)
    except ImportError as error:
        raise ConfigError(f"{name}: {error}; `oaisys_dataset[all]` has what it needs") from error
    except OSError as error:
        text = error.strerror or error
        raise RenderError(f"{place.url}: could not be written: {text}") from error
    return counts


@contextmanager
def _write_folder(place: StoragePlace) -> Iterator[Path]:
    """Yield an empty folder whose content is put to a place if the block succeeds."""
    target = place.folder
    if target is None:
        with temporary_folder("oaisys-export-") as folder:
            yield folder
            _upload(folder, place)
        return
    with whole_folder(target) as part:
        yield part


def _upload(folder: Path, place: StoragePlace) -> None:
    """Write all files of a folder to a place, README.md last; nothing remains if that fails."""
    names = [str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()]
    written: list[str] = []
    try:
        for name in sorted(names, key=lambda each: (each == README, each)):
            with place.writing(name) as path:
                shutil.move(folder / name, path)
            written.append(name)
    except BaseException:
        for name in written:
            place.delete(name)
        raise


def _count_missing(
    chosen: DatasetFormat, dataset: Dataset, needed: Sequence[str]
) -> dict[str, int]:
    """Return how many frames an export has left out, and how many lack an image beside others."""
    left_out, written = 0, 0
    having: Counter[str] = Counter()
    for record in dataset.records:
        is_complete = set(needed) <= set(record.images)
        left_out += not is_complete
        written += is_complete
        having.update(record.images.keys() if is_complete else ())
    counts = {frames_without_images(needed): left_out} if left_out else {}
    for modality in chosen.images_beside:
        # Where no frame has it, the data set is without, and nothing is missing.
        if 0 < having[modality] < written:
            counts[f"frames whose {modality} is missing"] = written - having[modality]
    return counts


def _require_content(name: str, dataset: Dataset, counts: Mapping[str, int]) -> None:
    """Raise if every frame was left out, and no scan was written instead.

    Raises:
        RenderError: Says what was left out.
    """
    left_out = {what: count for what, count in counts.items() if what.startswith(FRAMES_WITHOUT)}
    if sum(left_out.values()) >= len(dataset) and not counts.get(WRITTEN_SCANS):
        listed = "; ".join(f"{count} {what}" for what, count in left_out.items())
        raise RenderError(f"{name}: nothing to write: {listed}")


def _check(
    chosen: DatasetFormat, dataset: Dataset, place: StoragePlace, options: ExportOptions
) -> None:
    if not place.is_empty():
        raise InvalidInputError("out", place.url, "a folder that does not exist or is empty")
    if not len(dataset):
        raise InvalidInputError("dataset", dataset.place.url, "at least one frame")
    dataset.info.check_configs(f"{dataset.place.url}: {HEAD}")
    for setting in options.settings:
        if setting not in chosen.settings:
            raise InvalidInputError(
                f"settings.{setting}", setting, one_of(chosen.settings, setting)
            )
    fisheyes = {record.sensor for record in dataset.records if record.camera.is_fisheye}
    check_suits(chosen, modality_names(dataset), fisheyes)
