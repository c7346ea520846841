"""The shell command ``oaisys serve``."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from oaisys_core.cli.options import (
    BackendOption,
    ConfigOption,
    QualityOption,
    SeedOption,
    SizeOption,
)
from oaisys_grpc.addresses import DEFAULT_ADDRESS
from oaisys_grpc.server.options import GRACE_S, LEGACY_FOLDER, POSE_CACHE_MB
from oaisys_grpc.server.supervision.worker_limits import MEGABYTE


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
    worker_memory_limit_mb: Annotated[
        int | None,
        typer.Option(
            help="Resident memory at which the worker is replaced between two samples; "
            "0: no limit; default: 60 % of the machine's.",
            min=0,
        ),
    ] = None,
    pose_cache_mb: Annotated[
        int,
        typer.Option(help="Images that are kept for views that come again; 0: none.", min=0),
    ] = POSE_CACHE_MB,
    worker_log: Annotated[
        Path | None,
        typer.Option(help="Folder for what the worker prints; default: in ~/.local/state/oaisys."),
    ] = None,
    legacy_out: Annotated[
        Path,
        typer.Option(help="Folder for the images that clients of the original's service read."),
    ] = LEGACY_FOLDER,
    legacy_pose_policy: Annotated[
        Literal["reject", "clamp", "allow"] | None,
        typer.Option(
            help="What the original's service does with a pose under the ground or off the stage; "
            "default: as sensors.pose_policy says, but clamp where that is reject.",
        ),
    ] = None,
    asset_root: Annotated[
        list[Path] | None,
        typer.Option(
            help="Folder whose files requests may name; may be given more than once; "
            "default: the configuration file's.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
    shared_memory: Annotated[
        bool,
        typer.Option(help="Hand images to clients on this machine through shared memory."),
    ] = True,
    tls_cert: Annotated[
        Path | None, typer.Option(help="The server's certificate (PEM); encrypts the port.")
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Private key of the certificate.")] = None,
    tls_client_ca: Annotated[
        Path | None,
        typer.Option(help="Let only clients in whose certificates come from these authorities."),
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Serve other machines, without encryption.")
    ] = False,
) -> None:
    """Serve a simulator through gRPC; prints `ready: ADDRESS` when it does.

    SIGINT, SIGTERM and EndSimulation end it within 5 s, with exit code 0: calls under way get 2 s
    of them, unless a second signal comes.
    """
    # `oaisys --help` reads this module, too: what takes long to import waits until it is used.
    from oaisys_core.config import SimulationConfig, adjust, load_config
    from oaisys_grpc.addresses import check_address
    from oaisys_grpc.memory import keep_freed_memory
    from oaisys_grpc.server.options import ServerOptions
    from oaisys_grpc.server.server import serve as run_server
    from oaisys_grpc.server.supervision.worker_log import state_folder
    from oaisys_grpc.tls import ServerTls

    keep_freed_memory()
    gc.freeze()  # what has been imported is not looked through again and again
    chosen = load_config(config) if config else SimulationConfig()
    tls = ServerTls.of(tls_cert, tls_key, tls_client_ca)
    check_address(address, insecure=insecure, encrypted=tls is not None)
    run_server(
        adjust(chosen, seed=seed, backend=backend, quality=quality, size=size),
        address,
        ServerOptions(
            worker_python=worker_python,
            grace_s=grace,
            worker_memory_bytes=_bytes(worker_memory_limit_mb),
            pose_cache_bytes=pose_cache_mb * MEGABYTE,
            worker_log_folder=worker_log or state_folder(),
            legacy_folder=legacy_out,
            legacy_pose_policy=legacy_pose_policy,
            asset_roots=_asset_roots(asset_root, config),
            shared_memory=shared_memory,
            tls=tls,
        ),
        on_ready=_announce,
    )


def _asset_roots(given: list[Path] | None, config: Path | None) -> tuple[Path, ...]:
    if given:
        return tuple(given)
    return () if config is None else (config.resolve().parent,)


def _bytes(megabytes: int | None) -> int | None:
    return None if megabytes is None else megabytes * MEGABYTE


def _announce(address: str) -> None:
    typer.echo(f"ready: {address}")
    sys.stdout.flush()
