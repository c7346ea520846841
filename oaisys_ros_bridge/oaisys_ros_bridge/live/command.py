"""The shell command ``oaisys live``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.client.options import TlsCaOption, TlsCertOption, TlsKeyOption
from oaisys_ros_bridge.experiments.options import (
    BackendOption,
    ConfigOption,
    SeedOption,
    SizeOption,
    VoxelSizeOption,
    WorkerPythonOption,
    experiment_options,
)
from oaisys_ros_bridge.live_view.page_options import HostOption, PortOption

if TYPE_CHECKING:
    from oaisys_grpc.client.simulator_client import ClientTls


def live(
    out: Annotated[
        Path, typer.Option(help="Folder for pictures, bags, poses and configurations.")
    ] = Path("out/live"),
    config: ConfigOption = None,
    size: SizeOption = None,
    seed: SeedOption = None,
    backend: BackendOption = None,
    worker_python: WorkerPythonOption = None,
    address: Annotated[
        str | None, typer.Option(help="Address of a running server, in place of a new one.")
    ] = None,
    tls_ca: TlsCaOption = None,
    tls_cert: TlsCertOption = None,
    tls_key: TlsKeyOption = None,
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    still_quality: Annotated[
        str | None,
        typer.Option(
            help="Quality of colour while the camera stands still; default: standard with Blender, "
            "draft without. While it moves it is draft."
        ),
    ] = None,
    voxel_size: VoxelSizeOption = 0.20,
    max_range: Annotated[
        float, typer.Option(help="Largest depth that is mapped, metres.", min=0.1)
    ] = 40.0,
) -> None:
    """Fly or drive through a world in a browser: colour at several frames a second, and the map.

    Starts a simulator, or uses the one at --address, and prints `live: ` and the page's address,
    which answers only requests with the random token in it. The first browser drives; others look
    on, and may take over. Ends with Ctrl-C.
    """
    from oaisys_grpc.client.simulator_client import client_tls
    from oaisys_ros_bridge.experiments.interruption import interrupt_on_signals
    from oaisys_ros_bridge.live.options import LiveOptions
    from oaisys_ros_bridge.live.program import run_live

    own = {"--config": config, "--size": size, "--seed": seed, "--backend": backend}
    own["--worker-python"] = worker_python
    if address is not None and (
        given := [name for name, value in own.items() if value is not None]
    ):
        raise InvalidInputError("--address", address, f"none with {', '.join(given)}")
    tls: ClientTls | None = client_tls(tls_ca, tls_cert, tls_key)
    fields = experiment_options(
        out=out,
        config=config,
        size=size,
        voxel_size=voxel_size,
        max_range=max_range,
        seed=seed,
        backend=backend,
        quality=None,
        bag=False,
        namespace="",
        worker_python=worker_python,
        params_file=None,
        log_level="info",
        use_sim_time=False,
        key=None,
    )
    options = LiveOptions(host, port, out, still_quality or "", voxel_size, max_range)
    interrupt_on_signals()
    run_live(options, fields, address, tls, typer.echo)
