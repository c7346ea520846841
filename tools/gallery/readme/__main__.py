"""Make the README's pictures: `python -m tools.gallery.readme --survey out/survey`."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import typer

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import oaisys_core.render.blender  # noqa: F401
from oaisys_core.cli.standard_output import own_stdout
from tools.gallery.gallery import EXAMPLES
from tools.gallery.readme.animation import write_animation
from tools.gallery.readme.worlds import write_worlds

MOST_BYTES = 2_000_000
ANIMATION_QUALITY, STRIP_QUALITY = 75, 80
"""Of WebP."""


def main(
    survey: Annotated[Path, typer.Option(help="Output folder of `oaisys survey`.")],
    out: Annotated[Path, typer.Option(help="Folder for worlds.webp and survey.webp.")] = Path(
        "docs"
    ),
    backend: Annotated[str, typer.Option(help="blender or analytic.")] = "blender",
    quality: Annotated[str, typer.Option(help="Quality of colour.")] = "preview",
) -> None:
    """Render six worlds, and let the mesh of a survey grow; together at most 2 MB."""
    logging.basicConfig(level=logging.WARNING)
    out.mkdir(parents=True, exist_ok=True)
    with own_stdout():
        files = [
            write_animation(out / "survey.webp", survey, ANIMATION_QUALITY),
            write_worlds(out / "worlds.webp", EXAMPLES, backend, quality, STRIP_QUALITY),
        ]
    size = sum(file.stat().st_size for file in files)
    typer.echo(f"{', '.join(map(str, files))}: {size} bytes")
    if size > MOST_BYTES:
        typer.echo(f"pictures: {size} bytes received, expected at most {MOST_BYTES}", err=True)
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
