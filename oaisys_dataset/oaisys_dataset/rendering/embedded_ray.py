"""A Ray of this process alone: its start, its folder, and how all of it ends."""

from __future__ import annotations

import logging
import os
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from oaisys_core.errors import OaisysError
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_core.system.python_programs import python_environment
from oaisys_core.system.socket_paths import socket_parent
from oaisys_dataset.private.ray_job_config import safe_path_config
from oaisys_dataset.private.ray_options import start_in
from oaisys_dataset.rendering import session_guard
from oaisys_dataset.rendering.ray_settings import (
    RaySettings,
    check_gpus,
    worker_count,
)

_log = logging.getLogger(__name__)

STARTS = 6
"""How often Ray's daemons are started, if they fail. Ray's raylet gives up if the agents that it
starts are not ready in 15 seconds, which cannot be set; they need 3 seconds of a core."""

FOLDER = "oaisys_ray_"
"""How the name of Ray's temporary folder begins."""

INNER = "r"
"""The folder in it that Ray is given: Ray lets every user write to that one."""

LONGEST_SOCKET_BYTES = len("/session_2026-01-01_00-00-00_000000_4194304/sockets/plasma_store.12")
"""Of the paths of Ray's sockets in its folder; the number before them is a process's, and a second
try has another ending."""

_FAILED = re.compile(r"Check failed: (.*)")
"""Why a raylet has ended itself, in its log."""


@contextmanager
def embed_ray(ray: Any, settings: RaySettings, address: str) -> Iterator[Path]:
    """Run a Ray of this process alone, and yield its folder."""
    workers = worker_count(settings)
    # Otherwise Ray writes a token to ~/.ray, with which `ray start` then protects clusters, too.
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    with _python_environment(), _guard_folder() as folder:
        _start(ray, folder, settings, address, workers)
        try:
            check_gpus(ray, settings)
            yield folder / INNER
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
                    folder / INNER,
                    workers * settings.memory_bytes,
                    address=address,
                    num_cpus=workers,
                    include_dashboard=False,
                    job_config=safe_path_config(ray),
                    log_to_driver=False,
                    logging_level=logging.ERROR,
                )
        except Exception as error:  # Ray raises this very class if its daemons take too long
            logs = "" if left else keep_logs(folder / INNER)
            ray.shutdown()
            session_guard.clear(folder)
            if not left:
                raise OaisysError(f"Ray could not be started: {error}{logs}") from error
            _log.warning("Ray did not start, another try follows: %s", error)
            folder.mkdir(mode=0o700, exist_ok=True)
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


def keep_logs(folder: Path) -> str:
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
def _guard_folder() -> Iterator[Path]:
    """Yield a folder for Ray; at its end, or if this process dies, all that uses it is ended."""
    parent = socket_parent(len(f"/{FOLDER}12345678/{INNER}") + LONGEST_SOCKET_BYTES)
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
