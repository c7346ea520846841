"""The shell commands ``oaisys survey`` and ``oaisys bag``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.errors import InvalidInputError

bag_app = typer.Typer(help="Look into recorded bags.", no_args_is_help=True)


def survey(
    out: Annotated[Path, typer.Option(help="Folder for report, mesh, pictures and bag.")] = Path(
        "out/survey"
    ),
    config: Annotated[
        Path | None, typer.Option(help="YAML file; the default world where none is given.")
    ] = None,
    views: Annotated[int, typer.Option(help="Viewpoints on the grid.", min=1)] = 30,
    size: Annotated[
        str | None, typer.Option(help="WIDTHxHEIGHT of the images, for a quick look.")
    ] = None,
    altitude: Annotated[float, typer.Option(help="Metres above the ground below.")] = 10.0,
    overlap: Annotated[float, typer.Option(help="Share of an image that neighbours share.")] = 0.35,
    voxel_size: Annotated[float, typer.Option(help="Metres.", min=1e-3)] = 0.10,
    max_range: Annotated[float, typer.Option(help="Metres of depth that are mapped.")] = 60.0,
    seed: Annotated[int | None, typer.Option(help="Root seed of the world.")] = None,
    backend: Annotated[str | None, typer.Option(help="blender or analytic.")] = None,
    quality: Annotated[
        str | None, typer.Option(help="Of colour: preview, standard, high or final.")
    ] = None,
    bag: Annotated[bool, typer.Option(help="Record everything as a rosbag2 MCAP.")] = True,
    namespace: Annotated[
        str, typer.Option(help="Of all ROS nodes, TF included: two at once on one machine.")
    ] = "",
    worker_python: Annotated[
        Path | None, typer.Option(help="Interpreter that has bpy; this one if not given.")
    ] = None,
) -> None:
    """Survey a terrain over ROS, rebuild it, and measure the result; exit 0 if the loop closes."""
    from oaisys_ros_bridge.interruption import interrupt_on_signals
    from oaisys_ros_bridge.progress import Reporter
    from oaisys_ros_bridge.survey import run_survey
    from oaisys_ros_bridge.survey_plan import SurveyOptions

    if config is not None and not config.is_file():
        raise InvalidInputError("--config", str(config), "an existing file")
    chosen = {"seed": seed, "backend": backend, "quality": quality, "size": size}
    options = SurveyOptions(
        out=out,
        config=config,
        overrides={name: str(value) for name, value in chosen.items() if value is not None},
        views=views,
        altitude_m=altitude,
        overlap=overlap,
        voxel_size_m=voxel_size,
        max_range_m=max_range,
        record=bag,
        worker_python=worker_python,
        namespace=namespace,
        command=["oaisys", *sys.argv[1:]],
    )
    interrupt_on_signals()
    if not run_survey(options, Reporter()):
        raise typer.Exit(1)


@bag_app.command("info")
def bag_info(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
) -> None:
    """List a bag's topics, types and message counts."""
    from oaisys_ros_bridge.bag_info import summary_of

    for line in summary_of(bag):
        typer.echo(line)


@bag_app.command("recover")
def bag_recover(
    bag: Annotated[Path, typer.Argument(help="A bag's folder or its .mcap file.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder of the new bag; else beside the old one.")
    ] = None,
) -> None:
    """Copy what a recorder that was killed had written into a bag that opens everywhere."""
    from oaisys_ros_bridge.bag_info import mcap_file
    from oaisys_ros_bridge.bag_recovery import recover

    file = mcap_file(bag)
    folder = bag if bag.is_dir() else bag.with_suffix("")
    target = out or folder.with_name(f"{folder.name}_recovered")
    typer.echo(f"{target}: {recover(file, target)} messages")
