"""Options of a server."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from oaisys_grpc.server.supervision.worker_limits import MEGABYTE

if TYPE_CHECKING:  # they import gRPC and pydantic, which --help does not need
    from oaisys_core.config.sections.sensing.sensors import PosePolicy
    from oaisys_grpc.tls import ServerTls

GRACE_S = 30.0
"""From a call's deadline until a hung worker is killed."""

SHUTDOWN_GRACE_S = 2.0
"""For open calls after a request to end; the server ends within 5 s."""

POSE_CACHE_MB = 256
"""Of images: 60 samples at 640x480."""

LEGACY_FOLDER = Path("out/legacy")
"""Relative to where the server runs."""


@dataclass(frozen=True)
class ServerOptions:
    """What can be chosen of a server besides its configuration and address.

    Attributes:
        worker_python: Interpreter of the worker, which has Blender.
        grace_s: How long after a call's deadline a worker that hangs is killed.
        shutdown_grace_s: How long open calls may go on after a request to end.
        worker_memory_bytes: Resident memory at which a worker is replaced between two samples; 0:
            no limit; None: a share of the machine's.
        pose_cache_bytes: Images that the worker keeps for repeated views; 0: none.
        worker_log_folder: For logs of what workers print; None: no logs.
        legacy_folder: Where the original's service writes its files.
        legacy_pose_policy: What the original's service does with a pose under the ground or off
            the stage; None: as configured, but ``clamp`` where that is ``reject``.
        asset_roots: Folders whose files requests may name.
        shared_memory: Hand images to clients on this machine without copying them.
        tls: Encrypts the port and restricts who may connect; None: neither.
    """

    worker_python: str = sys.executable
    grace_s: float = GRACE_S
    shutdown_grace_s: float = SHUTDOWN_GRACE_S
    worker_memory_bytes: int | None = None
    pose_cache_bytes: int = POSE_CACHE_MB * MEGABYTE
    worker_log_folder: Path | None = None
    legacy_folder: Path = LEGACY_FOLDER
    legacy_pose_policy: PosePolicy | None = None
    asset_roots: tuple[Path, ...] = ()
    shared_memory: bool = True
    tls: ServerTls | None = None
