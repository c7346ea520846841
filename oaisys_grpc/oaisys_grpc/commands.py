"""The shell command ``oaisys serve``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from oaisys_core.command_options import (
    BackendOption,
    ConfigOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_core.config import SimulationConfig, adjusted, load_config
from oaisys_grpc.client import DEFAULT_ADDRESS
from oaisys_grpc.server import check_address
from oaisys_grpc.server import serve as run_server
from oaisys_grpc.supervisor import GRACE_S


def serve(
    config: ConfigOption = None,
    address: Annotated[
        str, typer.Option(help="HOST:PORT (port 0: any free one) or unix:PATH.")
    ] = DEFAULT_ADDRESS,
    backend: BackendOption = None,
    seed: SeedOption = None,
    quality: QualityOption = None,
    size: SizeOption = None,
    worker_python: Annotated[
        str, typer.Option(help="Python that has Blender's module bpy; default: this one.")
    ] = sys.executable,
    grace: Annotated[
        float,
        typer.Option(help="Seconds from a deadline until a hung worker is killed.", min=0),
    ] = GRACE_S,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Serve other machines, without encryption.")
    ] = False,
) -> None:
    """Serve a simulator through gRPC; prints `ready: ADDRESS` when it does."""
    chosen = load_config(config) if config else SimulationConfig()
    check_address(address, insecure)
    run_server(
        adjusted(chosen, seed=seed, backend=backend, quality=quality, size=size),
        address,
        worker_python=worker_python,
        grace_s=grace,
        on_ready=_announce,
    )


def _announce(address: str) -> None:
    typer.echo(f"ready: {address}")
    sys.stdout.flush()
