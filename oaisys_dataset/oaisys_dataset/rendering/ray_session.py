"""A connection to Ray: one embedded in this process, or a cluster that runs already."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oaisys_core.errors import ConfigError, InvalidInputError, OaisysError
from oaisys_core.files.numbers import whole_of
from oaisys_core.system.own_streams import keep_messages
from oaisys_dataset.private.ray_job_config import safe_path_config
from oaisys_dataset.private.ray_messages import write_reports_like_a_library
from oaisys_dataset.rendering.embedded_ray import embed_ray, keep_logs
from oaisys_dataset.rendering.ray_settings import (
    RaySettings,
    check_gpus,
    worker_slots,
)

ADDRESS_VARIABLE = "RAY_ADDRESS"
"""Environment variable with the address of a cluster, as Ray itself reads it."""

CLUSTER = "HOST:PORT of a Ray cluster to which this machine belongs, with the same RAY_AUTH_MODE"

REACHED_S = 5.0
"""Longest time in which the head of a cluster must be reached."""

WORKER_START_S = 300.0
"""Longest time until the first worker of an embedded Ray begins; it takes seconds on an idle
machine, and Ray itself would start workers that die at once again and again, for ever."""

LOG = "oaisys_messages_of_ray_"
"""How the name of the file with Ray's messages begins."""

ENDED = (
    "Ray has ended this command, because its daemon on this machine, the raylet, is gone;"
    " --resume renders the worlds that are missing; Ray's messages are in {log}"
)
"""What is said then: Ray ends its driver on a thread of its own, without an exception."""

_SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray's agents wait so long for a head that has died, a minute by default.
    "RAY_gcs_rpc_server_reconnect_timeout_s": "5",
    # By default, a world that needs more memory than there is would be tried for ever.
    "RAY_task_oom_retries": "3",
    # By default, workers have the priority 15: beside three busy programs on two cores they got a
    # fortieth of a core.
    "RAY_worker_niceness": "0",
}


@dataclass(frozen=True)
class RaySession:
    """A connection to Ray.

    Attributes:
        ray: The module.
        workers: Number of worlds that are rendered at a time.
        folder: Temporary folder of an embedded Ray; None for a cluster.
    """

    ray: Any
    workers: int
    folder: Path | None = None

    def start_error(self, reason: str) -> OaisysError:
        """Return an error that says where the logs of Ray are."""
        return OaisysError(reason if self.folder is None else f"{reason}{keep_logs(self.folder)}")


@contextmanager
def ray_session(settings: RaySettings) -> Iterator[RaySession]:
    """Connect to Ray, and disconnect at the end; an embedded one ends, and leaves nothing behind.

    Raises:
        ConfigError: Ray is not installed.
        InvalidInputError: A worker does not fit, or there is no cluster at the address.
    """
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ImportError as error:
        raise ConfigError(f"{error}; `pip install oaisys_dataset[all]` installs Ray") from error
    address = settings.address or os.environ.get(ADDRESS_VARIABLE) or None
    connected = _connect if address else embed_ray
    with (
        keep_messages(LOG, ENDED),
        write_reports_like_a_library(),
        connected(ray, settings, address or "local") as folder,
    ):
        yield RaySession(ray, settings.workers or worker_slots(ray, settings), folder)


@contextmanager
def _connect(ray: Any, settings: RaySettings, address: str) -> Iterator[None]:
    """Connect to a cluster."""
    _check_reachable(address)
    try:
        ray.init(
            address=address,
            job_config=safe_path_config(ray),
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InvalidInputError("address", address, f"{CLUSTER} ({error})") from error
    try:
        check_gpus(ray, settings)
        if not worker_slots(ray, settings):
            expected = "memory that a node of the cluster has"
            raise InvalidInputError("memory_per_worker", settings.memory_gb, expected)
        yield
    finally:
        ray.shutdown()


def _check_reachable(address: str) -> None:
    """Raise unless something answers at ``HOST:PORT``: Ray itself would end this process.

    Raises:
        InvalidInputError: Nothing does.
    """
    host, _, digits = address.rpartition(":")
    if not host or not digits.isdecimal():
        return  # another form, such as ``auto``
    port = whole_of(digits)
    if port is None:
        raise InvalidInputError("address", address, CLUSTER)
    try:
        socket.create_connection((host, port), REACHED_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidInputError("address", address, f"{CLUSTER} ({error})") from error


def worker_name() -> str:
    """Return the name of this process in the records of frames."""
    return f"{socket.gethostname()}:{os.getpid()}"
