"""A connection to Ray: one embedded in this process, or a cluster that runs already."""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oaisys_core.errors import ConfigError, InvalidInputError, OaisysError
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_core.system.own_streams import keep_messages
from oaisys_core.system.python_programs import python_environment
from oaisys_core.system.socket_paths import socket_parent
from oaisys_dataset.private.ray_job_config import safe_path_config
from oaisys_dataset.private.ray_messages import write_reports_like_a_library
from oaisys_dataset.private.ray_options import start_in
from oaisys_dataset.rendering import session_guard

ADDRESS_VARIABLE = "RAY_ADDRESS"
"""Environment variable with the address of a cluster, as Ray itself reads it."""

MEMORY_PER_WORKER_GB = 2.5
"""Memory reserved by default; Blender took up to 1.5 GB in worlds of 20,000 objects."""

USED_SHARE = 0.85
"""Share of the available memory that embedded workers may take together."""

CLUSTER = "HOST:PORT of a Ray cluster to which this machine belongs, with the same RAY_AUTH_MODE"

REACHED_S = 5.0
"""Longest time in which the head of a cluster must be reached."""

STARTS = 6
"""How often Ray's daemons are started, if they fail. Ray's raylet gives up if the agents that it
starts are not ready in 15 seconds, which cannot be set; they need 3 seconds of a core."""

WORKER_START_S = 300.0
"""Longest time until the first worker of an embedded Ray begins; it takes seconds on an idle
machine, and Ray itself would start workers that die at once again and again, for ever."""

ROUNDING = 1e-6
"""Of shares of a GPU, such as three times 0.333334."""

FOLDER = "oaisys_ray_"
"""How the name of Ray's temporary folder begins."""

LOG = "oaisys_messages_of_ray_"
"""How the name of the file with Ray's messages begins."""

ENDED = (
    "Ray has ended this command, because its daemon on this machine, the raylet, is gone;"
    " --resume renders the worlds that are missing; Ray's messages are in {log}"
)
"""What is said then: Ray ends its driver on a thread of its own, without an exception."""

LONGEST_SOCKET_BYTES = len("/session_2026-01-01_00-00-00_000000_4194304/sockets/plasma_store.12")
"""Of the paths of Ray's sockets in its folder; the number before them is a process's, and a second
try has another ending."""

_log = logging.getLogger(__name__)

_FAILED = re.compile(r"Check failed: (.*)")
"""Why a raylet has ended itself, in its log."""

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
class RaySettings:
    """Where worlds are rendered, and by how many workers.

    Attributes:
        address: ``HOST:PORT`` of a cluster; None for an embedded Ray.
        workers: Number of worlds that are rendered at a time; None for as many as fit.
        memory_gb: Memory that is reserved for each worker.
        retries: How often a world is rendered again after its worker or node died.
        gpus: GPUs of each worker; a share of one is shared, and 0 asks for none, so that workers
            see all GPUs of their machine.
    """

    address: str | None = None
    workers: int | None = None
    memory_gb: float = MEMORY_PER_WORKER_GB
    retries: int = 3
    gpus: float = 0.0

    def __post_init__(self) -> None:
        if self.gpus < 0 or (self.gpus > 1 and self.gpus != int(self.gpus)):
            expected = "a share of one GPU, or a whole number of them"
            raise InvalidInputError("gpus_per_worker", self.gpus, expected)

    @property
    def memory_bytes(self) -> int:
        """Memory that is reserved for each worker."""
        return int(self.memory_gb * 1e9)

    def remote(self, ray: Any, function: Callable[..., Any]) -> Any:
        """Return a function of Ray whose tasks get what a worker needs.

        Ray shows a task its GPUs alone, by ``CUDA_VISIBLE_DEVICES`` and the like. A process keeps
        those that it has seen first, so with GPUs each task gets a process of its own.
        """
        gpus: dict[str, Any] = {"num_gpus": self.gpus, "max_calls": 1} if self.gpus else {}
        asked = {"num_cpus": 1, "memory": self.memory_bytes, "max_retries": self.retries}
        return ray.remote(**asked, **gpus)(function)


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
        return OaisysError(reason if self.folder is None else f"{reason}{_keep_logs(self.folder)}")


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
    connected = _connect if address else _embed
    with (
        keep_messages(LOG, ENDED),
        write_reports_like_a_library(),
        connected(ray, settings, address or "local") as folder,
    ):
        yield RaySession(ray, settings.workers or _slots(ray, settings), folder)


def worker_count(settings: RaySettings) -> int:
    """Return how many workers an embedded Ray has: what was asked for, or one for each core.

    There are fewer where their memory would not suffice.

    Raises:
        InvalidInputError: Not even one fits.
    """
    usable = USED_SHARE * available_bytes()
    if settings.memory_bytes > usable:
        expected = f"at most {usable / 1e9:.1f}, which this machine has"
        raise InvalidInputError("memory_per_worker", settings.memory_gb, expected)
    if settings.workers is not None:
        return settings.workers
    return max(1, min(len(os.sched_getaffinity(0)), int(usable // settings.memory_bytes)))


def available_bytes() -> int:
    """Return the memory that this process and its children may still take."""
    lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    found = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable")]
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = ((group / f"memory.{name}").read_text() for name in ("max", "current"))
        found.append(int(limit) - int(used))
    except (OSError, ValueError):
        pass  # there is no group, or it has no limit
    return max(0, min(found))


@contextmanager
def _embed(ray: Any, settings: RaySettings, address: str) -> Iterator[Path]:
    """Run a Ray of this process alone, and yield its folder."""
    workers = worker_count(settings)
    # Otherwise Ray writes a token to ~/.ray, with which `ray start` then protects clusters, too.
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    with _python_environment(), _guard_folder() as folder:
        _start(ray, folder, settings, address, workers)
        try:
            _check_gpus(ray, settings)
            yield folder
        finally:
            ray.shutdown()


def _start(ray: Any, folder: Path, settings: RaySettings, address: str, workers: int) -> None:
    """Start Ray's daemons, again if that fails: their files are in memory then.

    Raises:
        OaisysError: They could not be started.
    """
    for left in reversed(range(STARTS)):
        try:
            with _temporary_files_in(folder):
                start_in(
                    ray,
                    folder,
                    workers * settings.memory_bytes,
                    address=address,
                    num_cpus=workers,
                    include_dashboard=False,
                    job_config=safe_path_config(ray),
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                )
        except Exception as error:  # Ray raises this very class if its daemons take too long
            logs = "" if left else _keep_logs(folder)
            ray.shutdown()
            session_guard.clear(folder)
            if not left:
                raise OaisysError(f"Ray could not be started: {error}{logs}") from error
            _log.warning("Ray did not start, another try follows: %s", error)
            folder.mkdir(exist_ok=True)
        else:
            return


@contextmanager
def _python_environment() -> Iterator[None]:
    """Give Ray's programs, which inherit the variables of this process, those for Python."""
    before = dict(os.environ)
    after = python_environment(before)
    changed = {name for name, value in after.items() if before.get(name) != value}
    os.environ.update(after)
    try:
        yield
    finally:
        for name in changed:
            if name in before:
                os.environ[name] = before[name]
            else:
                del os.environ[name]


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    """Have what is started make its temporary files in a folder: killed workers leave them."""
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = str(folder)
    try:
        yield
    finally:
        os.environ.pop("TMPDIR")
        if before is not None:
            os.environ["TMPDIR"] = before


def _keep_logs(folder: Path) -> str:
    """Copy the logs of a Ray that is given up, and return where they are, and the machine's load.

    Its own folder is removed at its end.
    """
    load = f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores"
    logs = folder / "session_latest" / "logs"
    if not logs.is_dir():
        return f" (no logs; {load})"
    kept = Path(tempfile.mkdtemp(prefix="oaisys_failed_ray_"))
    shutil.copytree(logs, kept, dirs_exist_ok=True)
    failed = [
        found[1] for path in kept.glob("raylet.out") if (found := _FAILED.search(_text(path)))
    ]
    return f" ({', '.join(failed) or 'no reason'} in the logs {kept}; {load})"


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace")


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
        _check_gpus(ray, settings)
        if not _slots(ray, settings):
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
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        return  # another form, such as ``auto``
    try:
        socket.create_connection((host, int(port)), REACHED_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidInputError("address", address, f"{CLUSTER} ({error})") from error


@contextmanager
def _guard_folder() -> Iterator[Path]:
    """Yield a folder for Ray; at its end, or if this process dies, all that uses it is ended."""
    parent = socket_parent(len(f"/{FOLDER}12345678") + LONGEST_SOCKET_BYTES)
    with temporary_folder(FOLDER, parent) as folder, _guard(folder):
        yield folder


@contextmanager
def _guard(folder: Path) -> Iterator[None]:
    command = [sys.executable, "-I", "-S", session_guard.__file__, str(folder)]
    guard = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    # Set after the guard has started, so that it is not marked itself.
    os.environ[session_guard.MARK] = str(folder)
    try:
        yield
    finally:
        del os.environ[session_guard.MARK]
        try:
            guard.communicate(timeout=2 * session_guard.PATIENCE_S)
        except subprocess.TimeoutExpired:
            guard.kill()
            guard.communicate()
        if folder.exists():
            raise OaisysError(f"{folder}: could not be removed, Ray may still be running")


def _slots(ray: Any, settings: RaySettings) -> int:
    """Return how many workers the nodes have room for, with one core and their GPUs each."""
    total = 0
    for found in _resources(ray):
        slots = [found.get("CPU", 0), found.get("memory", 0) // settings.memory_bytes]
        if settings.gpus:
            slots.append(found.get("GPU", 0) / settings.gpus + ROUNDING)
        total += int(min(slots))
    return total


def _check_gpus(ray: Any, settings: RaySettings) -> None:
    """Raise unless a node has the GPUs of a worker: Ray would wait for them for ever."""
    if not settings.gpus:
        return
    most = max((found.get("GPU", 0) for found in _resources(ray)), default=0)
    if settings.gpus > most:
        expected = f"at most {most:g}, which Ray finds on the machine that has most"
        raise InvalidInputError("gpus_per_worker", settings.gpus, expected)


def _resources(ray: Any) -> list[dict[str, float]]:
    return [node["Resources"] for node in ray.nodes() if node["Alive"]]


def worker_name() -> str:
    """Return the name of this process in the records of frames."""
    return f"{socket.gethostname()}:{os.getpid()}"
