"""Options that several shell commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="YAML file; default: the default world.")
]
SeedOption = Annotated[int | None, typer.Option(help="Root seed.")]
BackendOption = Annotated[str | None, typer.Option(help="blender or analytic.")]
QualityOption = Annotated[
    str | None,
    typer.Option(help="Quality of colour: preview, standard, high, final or geometry (none)."),
]
SizeOption = Annotated[
    str | None, typer.Option(help="WIDTHxHEIGHT of all images; K is scaled accordingly.")
]
