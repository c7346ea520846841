"""Options that several shell commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ConfigOption = Annotated[
    Path | None, typer.Option("--config", help="YAML file; default: the default world.")
]
PosesOption = Annotated[
    Path | None,
    typer.Option(
        "--poses",
        help="File of poses, one per view: CSV as poses.csv, TUM, EuRoC, KITTI, COLMAP's "
        "images.txt, transforms.json, MCAP bag.",
    ),
]
PosesCameraOption = Annotated[
    str | None,
    typer.Option(
        help="Camera whose optical frame the poses are of; default: the first camera for KITTI, "
        "COLMAP and transforms.json, else the rig's base."
    ),
]
PosesTopicOption = Annotated[
    str | None, typer.Option(help="Topic of a bag; default: its only one with poses.")
]
PosesFrameOption = Annotated[
    str | None,
    typer.Option(help="Frame whose transforms are the poses, in a bag; default: base_link."),
]
SeedOption = Annotated[int | None, typer.Option(help="Root seed.")]
BackendOption = Annotated[str | None, typer.Option(help="blender or analytic.")]
QualityOption = Annotated[
    str | None,
    typer.Option(
        help="Quality of colour: draft, preview, standard, high, final or geometry (none)."
    ),
]
SizeOption = Annotated[
    str | None, typer.Option(help="WIDTHxHEIGHT of all images; K is scaled by the width.")
]
