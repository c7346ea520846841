"""The shell command ``oaisys view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.errors import InvalidInputError


def view(
    address: Annotated[
        str | None, typer.Option(help="Of a running server, to watch it over gRPC.")
    ] = None,
    ros: Annotated[bool, typer.Option("--ros", help="Watch the topics of bridge and mapper.")] = (
        False
    ),
    camera: Annotated[
        list[str] | None,
        typer.Option(help="Prefix of a camera's topics; can be given again."),
    ] = None,
    map_frame: Annotated[str, typer.Option(help="Frame to show everything in.")] = "map",
    host: Annotated[
        str, typer.Option(help="Address to serve the page on; 0.0.0.0 for the network.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Of the page; 0 for a free one.", min=0)] = 8080,
    voxel_size: Annotated[
        float, typer.Option(help="Of the mesh that is made here, metres.", min=1e-3)
    ] = 0.10,
    max_range: Annotated[float, typer.Option(help="Metres of depth that are shown.", min=0.1)] = (
        60.0
    ),
    views: Annotated[
        int | None, typer.Option(help="End after so many views; else with Ctrl-C.", min=1)
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(help="At the end, write the scene here as one .html file, and exit."),
    ] = None,
) -> None:
    """Show what a simulator sees, as it comes, in a browser: cameras, images, cloud and mesh.

    Without --ros over gRPC, from --address. The mesh is the mapper's where one publishes it, and
    made here where none does.
    """
    from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals
    from oaisys_ros_bridge.live_view.view import ViewOptions, run_view

    if ros and address is not None:
        raise InvalidInputError("--address", address, "none with --ros")
    if save is not None and not save.absolute().parent.is_dir():
        raise InvalidInputError("--save", str(save), "a file in an existing folder")
    options = ViewOptions(
        address=address,
        ros=ros,
        cameras=tuple(camera or ("camera",)),
        map_frame=map_frame,
        host=host,
        port=port,
        voxel_size_m=voxel_size,
        max_range_m=max_range,
        views=views,
        save=save,
    )
    interrupt_on_signals()
    run_view(options, typer.echo)
