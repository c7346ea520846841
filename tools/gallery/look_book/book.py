"""The look book: presets and written worlds at two elevations of the sun and three heights."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Annotated

import typer

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import oaisys_core.render.blender  # noqa: F401
from oaisys_core.cli.standard_output import own_stdout
from tools.gallery.look_book.rendering import LookPicture, render_world
from tools.gallery.look_book.table import table, write_json, write_sheet
from tools.gallery.look_book.views import look_worlds

EXAMPLES = Path(__file__).parents[3] / "config" / "examples"
SIZE = "960x720"


def main(
    out: Annotated[Path, typer.Option(help="Folder for pictures, figures and contact sheet.")],
    only: Annotated[str, typer.Option(help="Render only worlds whose names contain this.")] = "",
    quality: Annotated[str, typer.Option(help="Quality of colour.")] = "standard",
    size: Annotated[str, typer.Option(help="Size of a picture.")] = SIZE,
) -> None:
    """Render ten presets and the written worlds, and print figures of each picture."""
    logging.basicConfig(level=logging.WARNING)
    with own_stdout():
        pictures = render_look_book(out, only, quality=quality, size=size)
    if any(picture.error for picture in pictures):
        raise typer.Exit(1)


def render_look_book(
    out: Path,
    only: str = "",
    *,
    backend: str = "blender",
    quality: str = "standard",
    size: str = SIZE,
) -> list[LookPicture]:
    """Write pictures, ``look_book.json`` and the contact sheet ``look_book.jpg``; print figures."""
    out.mkdir(parents=True, exist_ok=True)
    pictures: list[LookPicture] = []
    for world in look_worlds(EXAMPLES, only):
        started_s = time.perf_counter()
        pictures += render_world(world, out, backend, quality, size)
        typer.echo(f"look_book/{world.name}: {time.perf_counter() - started_s:.1f} s")
    write_json(out / "look_book.json", pictures)
    write_sheet(out / "look_book.jpg", out, pictures)
    typer.echo(table(pictures))
    for picture in pictures:
        if picture.error:
            typer.echo(f"{picture.world}, {picture.view}: {picture.error}", err=True)
    return pictures
