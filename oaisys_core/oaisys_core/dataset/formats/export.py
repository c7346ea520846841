"""The export of a data set in a format, with all that describes it."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_core.dataset.card.description import description_files
from oaisys_core.dataset.formats.base import (
    DatasetFormat,
    ExportOptions,
    format_named,
    modality_names,
)
from oaisys_core.errors import ConfigError, InvalidInputError, RenderError, one_of

if TYPE_CHECKING:
    from oaisys_core.dataset.reader import Dataset


def export_dataset(
    dataset: Dataset, name: str, target: Path, options: ExportOptions | None = None
) -> Mapping[str, int]:
    """Write a data set in a format; ``target`` appears when everything is written.

    Args:
        dataset: What is written.
        name: Name of the format.
        target: A folder that does not exist yet, or is empty.
        options: The caller's choices.

    Returns:
        How many of what were written or left out.

    Raises:
        InvalidInputError: The format, a setting, the folder or the data set does not suit.
        RenderError: It could not be written; nothing is left.
        ConfigError: A package is missing that the format needs.
    """
    options = options or ExportOptions()
    chosen = format_named(name)
    _check(chosen, dataset, target, options)
    part = target.with_name(f".{target.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        counts = chosen.write(dataset, part, options)
        described = description_files(dataset, name, chosen.conventions, counts, options)
        for file, data in described.items():
            (part / file).write_bytes(data)
        part.replace(target)
    except ImportError as error:
        raise ConfigError(f"{name}: {error}; `oaisys_core[dataset]` has what it needs") from error
    except OSError as error:
        raise RenderError(f"{target}: could not be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return counts


def _check(chosen: DatasetFormat, dataset: Dataset, target: Path, options: ExportOptions) -> None:
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InvalidInputError("out", str(target), "a folder that does not exist or is empty")
    if not len(dataset):
        raise InvalidInputError("dataset", str(dataset), "at least one frame")
    for setting in options.settings:
        if setting not in chosen.settings:
            raise InvalidInputError(
                f"settings.{setting}", setting, one_of(chosen.settings, setting)
            )
    missing = sorted(set(chosen.modalities) - set(modality_names(dataset)))
    if missing:
        expected = f"also {', '.join(missing)}, without which {chosen.name} has no content"
        raise InvalidInputError("dataset", ", ".join(modality_names(dataset)), expected)
