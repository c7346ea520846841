"""The gallery: every example and texture set, rendered with its labels, and the look book."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import oaisys_core.render.blender  # noqa: F401
from oaisys_core.cli.standard_output import own_stdout
from oaisys_core.errors import OaisysError
from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, ModuleMetadata
from tools.gallery.geomorphometry import write_geomorphometry
from tools.gallery.look_book.book import render_look_book
from tools.gallery.look_book.figures import marks
from tools.gallery.look_book.rendering import LookPicture
from tools.gallery.page import Entry, ViewImages, write_page, write_view_images
from tools.gallery.scenes import Picture, picture_names, pictures

EXAMPLES = Path(__file__).parents[2] / "config" / "examples"
LOOK_BOOK = "look_book"
GEOMORPHOMETRY = "geomorphometry"
OWN_VIEWS = 2
"""Number of views of a rig with its own motion."""


def main(
    out: Annotated[Path, typer.Option(help="Folder for the page and its images.")],
    only: Annotated[
        str, typer.Option(help="Render only names that contain this, such as stage_ or look_book.")
    ] = "",
    quality: Annotated[str, typer.Option(help="Quality of colour.")] = "high",
    backend: Annotated[str, typer.Option(help="blender or analytic.")] = "blender",
) -> None:
    """Render all examples and texture sets with their labels, and the look book.

    The look book has `standard` quality.
    """
    logging.basicConfig(level=logging.WARNING)
    if not any(only in name for name in (*picture_names(EXAMPLES), LOOK_BOOK, GEOMORPHOMETRY)):
        raise typer.BadParameter(f"received {only!r}, expected a part of a name", param_hint="only")
    out.mkdir(parents=True, exist_ok=True)
    with own_stdout():
        failures = _render(out, only, quality, backend)
    for failure in failures:
        typer.echo(failure, err=True)
    if failures:
        raise typer.Exit(1)


def _render(out: Path, only: str, quality: str, backend: str) -> list[str]:
    """Write the gallery and return the errors."""
    entries, failures, version = [], [], ""
    for chosen in pictures(EXAMPLES, only, backend, quality):
        started_s = time.perf_counter()
        simulation = Simulation(chosen.config)
        try:
            entries.append(_entry(simulation, chosen, out))
            version = simulation.info().backend_version
        except OaisysError as error:
            failures.append(f"{chosen.group}/{chosen.name}: {error}")
        finally:
            simulation.close()
        typer.echo(f"{chosen.group}/{chosen.name}: {time.perf_counter() - started_s:.1f} s")
    if only in LOOK_BOOK:
        book = render_look_book(out, backend=backend)
        failures += [f"{each.world}: {each.error}" for each in book if each.error]
        entries += _look_book_entries(book)
    if only in GEOMORPHOMETRY:
        typer.echo(write_geomorphometry(out))
    page = write_page(out, entries, f"{backend} {version}, quality {quality}")
    typer.echo(f"{page}: {len(entries)} worlds")
    return failures


def _entry(simulation: Simulation, chosen: Picture, out: Path) -> Entry:
    simulation.step_batch()
    images: list[ViewImages] = []
    views = chosen.views or (None,) * OWN_VIEWS
    for index, view in enumerate(views, start=1):
        sensor = None if view is None else {"pose": view.pose(simulation)}
        sample = simulation.step_sample(ModuleMetadata(sensor=sensor))
        title = f"view {index}" if view is None else view.name
        stem = f"{chosen.group}_{chosen.name}_{index}"
        labels = {0: "unlabelled", **simulation.info().semantic_labels}
        images += write_view_images(out, stem, title, sample, labels)
    return Entry(chosen.group, chosen.name, chosen.caption, images)


def _look_book_entries(book: Sequence[LookPicture]) -> list[Entry]:
    """Return one entry for each world; an asterisk marks figures out of the natural range."""
    entries = []
    for world, pictures_of_world in groupby(book, lambda picture: picture.world):
        images = [
            ViewImages(picture.view, {RGB: picture.file}, {}, marks(picture.figures))
            for picture in pictures_of_world
            if picture.file is not None
        ]
        entries.append(Entry(LOOK_BOOK, world, "", images))
    return entries
