"""The shell command ``oaisys view``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.client.options import TlsCaOption, TlsCertOption, TlsKeyOption
from oaisys_ros_bridge.live_view.page_options import HostOption, PortOption


def view(
    address: Annotated[
        str | None, typer.Option(help="Address of a running server, to show it over gRPC.")
    ] = None,
    tls_ca: TlsCaOption = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
    ros: Annotated[bool, typer.Option("--ros", help="Show the topics of bridge and mapper.")] = (
        False
    ),
    camera: Annotated[
        list[str] | None,
        typer.Option(help="Prefix of a camera's topics; repeatable."),
    ] = None,
    map_frame: Annotated[str, typer.Option(help="Frame in which everything is shown.")] = "map",
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    voxel_size: Annotated[
        float, typer.Option(help="Voxel size of the mesh that is made here, metres.", min=1e-3)
    ] = 0.10,
    max_range: Annotated[
        float, typer.Option(help="Largest depth that is shown, metres.", min=0.1)
    ] = (60.0),
    views: Annotated[
        int | None,
        typer.Option(help="Number of views after which it ends; else with Ctrl-C.", min=1),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(help="File to which the scene is written at the end, as one .html file."),
    ] = None,
) -> None:
    """Show a running simulator in a browser: cameras, images, point cloud and mesh.

    The data come from the server at --address over gRPC, or with --ros from topics. The mesh is
    the mapper's if it publishes one; otherwise it is made here. Open the page at the address that
    is printed: it answers only requests with the random token in it.
    """
    from oaisys_grpc.client.simulator_client import client_tls
    from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals
    from oaisys_ros_bridge.live_view.view import ViewOptions, run_view

    tls = client_tls(tls_ca, tls_cert, tls_key)
    if ros and address is not None:
        raise InvalidInputError("--address", address, "none with --ros")
    if ros and tls is not None:
        raise InvalidInputError("--ros", ros, "none of it with the TLS options")
    if save is not None and not save.absolute().parent.is_dir():
        raise InvalidInputError("--save", str(save), "a file in an existing folder")
    options = ViewOptions(
        address=address,
        tls=tls,
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
