"""Make the site's small pictures: `python -m tools.gallery.names [GROUP ...] [--missing]`."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import typer

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import oaisys_core.render.blender  # noqa: F401
from oaisys_core.cli.standard_output import own_stdout
from tools.gallery.names.keys import KEY_PAIRS, PAIRS
from tools.gallery.names.looks_page import write_looks_page
from tools.gallery.names.rendering import beside, render_pictures, write_picture
from tools.gallery.names.worlds import all_pictures
from tools.programs import ROOT

FOLDER = ROOT / "docs" / "pictures"


def main(
    groups: Annotated[list[str] | None, typer.Argument(help="Default: all of them.")] = None,
    missing: Annotated[bool, typer.Option(help="Only pictures that there are not yet.")] = False,
    only: Annotated[str, typer.Option(help="Part of the names of pictures to make.")] = "",
    out: Annotated[Path, typer.Option(help="Folder of the pictures.")] = FOLDER,
    backend: Annotated[str, typer.Option(help="blender or analytic.")] = "blender",
    quality: Annotated[str, typer.Option(help="Quality of colour.")] = "standard",
) -> None:
    """Render a picture of each name and two of each key; write the page of the keys."""
    logging.basicConfig(level=logging.WARNING)

    def is_due(group: str, name: str) -> bool:
        there = missing and (out / group / f"{name}.webp").exists()
        return (not groups or group in groups) and only in name and not there

    due = [each for each in all_pictures() if is_due(each.group, each.name)]
    with own_stdout():
        for picture, image in render_pictures(due, backend, quality):
            write_picture(image, out / picture.group / f"{picture.name}.webp")
        for pair in KEY_PAIRS:
            if is_due(PAIRS, pair.name):
                (_, left), (_, right) = render_pictures(pair.pictures(), backend, quality)
                write_picture(beside(left, right), out / PAIRS / f"{pair.name}.webp")
    write_looks_page()


if __name__ == "__main__":
    typer.run(main)
