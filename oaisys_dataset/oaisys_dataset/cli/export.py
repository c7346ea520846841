"""``oaisys dataset export`` and ``describe``: a data set for other programs, and about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.errors import InvalidInputError, one_of

if TYPE_CHECKING:
    from oaisys_dataset.formats.base import DatasetFormat, ExportOptions
    from oaisys_dataset.reader import Dataset

EXPORTS = "exports"
"""Folder in a data set that has its exports by default, each under its format's name."""

PlaceArgument = Annotated[
    str, typer.Argument(metavar="DIR", help="Folder or URL of a data set.", show_default=False)
]
LicenseOption = Annotated[
    str, typer.Option("--license", help="Licence of the data set: an SPDX name, URL or text.")
]
PriceOption = Annotated[
    float | None, typer.Option(help="Price of one worker for an hour, for the data card.", min=0)
]


def export(
    place: Annotated[
        str | None,
        typer.Argument(metavar="DIR", help="Folder or URL of a data set.", show_default=False),
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="Name of a format; may be repeated.", show_default=False),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(help="New folder or URL for the export; default: DIR/exports/NAME."),
    ] = None,
    split: Annotated[str | None, typer.Option(help="Export only the worlds of this split.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE, a setting of the format; may be repeated."),
    ] = None,
    license_name: LicenseOption = "",
    price_per_hour: PriceOption = None,
    shows_formats: Annotated[
        bool,
        typer.Option("--list", help="List the installed formats and their settings, and exit."),
    ] = False,
) -> None:
    """Write the data set in DIR in other formats.

    Each export has a README.md with its conventions, Croissant metadata and a data card.
    """
    # `oaisys --help` imports this module, so slow imports are done on use.
    from oaisys_dataset.formats.base import ExportOptions, format_named, format_names
    from oaisys_dataset.reader import open_dataset

    if shows_formats:
        others = (place, formats, out, split, settings, license_name or None, price_per_hour)
        if any(each is not None for each in others):
            expected = "alone, because it lists formats and exports nothing"
            raise InvalidInputError("--list", "with DIR or other options", expected)
        typer.echo("\n".join(_describe(format_named(name)) for name in format_names()))
        return
    if place is None:
        raise InvalidInputError("DIR", None, "folder or URL of a data set; or --list alone")
    chosen = [format_named(name).name for name in formats or ()]
    if not chosen:
        raise InvalidInputError("format", None, f"--format with one of {', '.join(format_names())}")
    if len(set(chosen)) < len(chosen):
        raise InvalidInputError("format", ", ".join(chosen), "each format once")
    if out is not None and len(chosen) > 1:
        raise InvalidInputError("out", out, "one --format, or no --out")
    dataset = open_dataset(place)
    if split is not None:
        if split not in dataset.splits:
            raise InvalidInputError("split", split, one_of(dataset.splits, split))
        dataset = dataset.split(split)
    given = _settings(settings or ())
    for name in chosen:
        options = ExportOptions(given, license_name, price_per_hour)
        write_export(dataset, name, out or export_place(place, name), options)


def export_place(place: str, name: str) -> str:
    """Return where a data set has its export in a format by default.

    Raises:
        InvalidInputError: A link in the data set, which somebody else may have made, leads away.
    """
    exports = f"{place.rstrip('/')}/{EXPORTS}"
    if "://" not in place and Path(exports).is_symlink():
        raise InvalidInputError("out", exports, "a folder; it is a link (--out FOLDER)")
    return f"{exports}/{name}"


def write_export(dataset: Dataset, name: str, target: str, options: ExportOptions) -> None:
    """Write a data set in a format, show the progress, and print what was written."""
    from oaisys_core.system.progress_display import ProgressDisplay
    from oaisys_dataset.formats.export import export_dataset

    with ProgressDisplay(name, len(dataset)) as display:
        counts = export_dataset(dataset, name, target, replace(options, progress=display.count))
    told = "; ".join(f"{count} {what}" for what, count in counts.items() if count)
    typer.echo(f"{target}: {name}: {told}")


def describe(
    place: PlaceArgument, license_name: LicenseOption = "", price_per_hour: PriceOption = None
) -> None:
    """Write README.md, frames.csv, Croissant metadata and a data card into the data set in DIR.

    They describe the worlds that are finished now, and replace earlier ones.
    """
    from oaisys_dataset.card.description import describe_dataset
    from oaisys_dataset.formats.base import ExportOptions
    from oaisys_dataset.reader import open_dataset

    options = ExportOptions(license=license_name, price_per_hour=price_per_hour)
    names = describe_dataset(open_dataset(place), options)
    typer.echo(f"{place}: {', '.join(names)}")


def _settings(texts: Sequence[str]) -> dict[str, str]:
    """Return the values of `--set` by their names."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InvalidInputError("set", text, "NAME=VALUE")
        if name in found:
            raise InvalidInputError("set", text, f"each name once; {name} is {found[name]} already")
        found[name] = value
    return found


def _describe(found: DatasetFormat) -> str:
    """Return the lines about a format in the list."""
    about = (type(found).__doc__ or "").split("\n")[0]
    settings = [f"    --set {name}=...: {meaning}" for name, meaning in found.settings.items()]
    return "\n".join([f"{found.name}: {about}", *settings])
