"""Calls functions in other processes, where Blender may be imported.

Blender's data is global to a process and does not get on with an Open3D that came first, so no
test imports it into pytest's process. Most jobs are done one after the other by one process, which
begins each with an empty Blender, as the product's worker does with each world. Tests that need
Blender are skipped where it is not installed, and for no other reason.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

import pytest
from leak_check import MARK

TIMEOUT_S = 300.0
"""Seconds for one job; whatever takes longer hangs."""
END_S = 20.0
"""Seconds for a process without jobs to end."""

ENVIRONMENT = {name: value for name, value in os.environ.items() if name != MARK}
"""What the shared process gets: not what the test that first needs it has set."""


def skip_without_blender(*, module: bool = False) -> None:
    """Skip the test, or the whole module, where there is no ``bpy``; nothing is imported."""
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed", allow_module_level=module)


def require_blender() -> None:
    """As `skip_without_blender`; where there is a ``bpy`` it must import, else the test fails."""
    skip_without_blender()
    importlib.import_module("bpy")


class BlenderJobError(AssertionError):
    """A job that did not return, with its name and what its process wrote."""


class BlenderProcess:
    """A process with Blender that does one job after the other, and ends with its parent."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._connection, theirs = Pipe()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `end`
        self._process = subprocess.Popen(
            [sys.executable, __file__, str(theirs.fileno()), str(os.getpid())],
            pass_fds=[theirs.fileno()],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
        )
        theirs.close()

    @property
    def is_usable(self) -> bool:
        """Whether it takes another job: none has failed, and it runs."""
        return not self._connection.closed and self._process.poll() is None

    def call(self, job: str, arguments: tuple[Any, ...], timeout_s: float = TIMEOUT_S) -> Any:
        """Return what a job returns; the process is ended after one that fails."""
        try:
            self._connection.send((job, arguments))
            if not self._connection.poll(timeout_s):
                self._process.kill()
                raise BlenderJobError(f"{job}: killed after {timeout_s:g} s\n{self.end()}")
            is_done, result = self._connection.recv()
        except (EOFError, OSError) as error:
            told = self.end()
            code = self._process.returncode
            raise BlenderJobError(f"{job}: its process ended with {code}\n{told}") from error
        if not is_done:
            self.end()
            raise BlenderJobError(f"{job} in Blender's process:\n{result}")
        return result

    def end(self) -> str:
        """End the process, if it runs, and return the end of what it wrote to standard error."""
        if self._connection.closed:
            return ""
        self._connection.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(END_S)
        with self._errors as file:
            file.seek(0)
            return file.read().decode(errors="replace")[-4000:]


_shared: BlenderProcess | None = None


def in_blender(job: str, *arguments: Any) -> Any:
    """Return what a function of `blender_jobs` returns in the process that these calls share.

    ``job`` is ``module.function``; it undoes whatever it changes of Python's modules. Arguments and
    result are pickled. Skips the test where there is no ``bpy``.
    """
    global _shared
    skip_without_blender()
    if _shared is None or not _shared.is_usable:
        end_shared_blender()
        _shared = BlenderProcess(ENVIRONMENT)
    return _shared.call(job, arguments)


def in_new_blender(job: str, *arguments: Any) -> Any:
    """Return the same from a new process, for jobs that are about a process's life or memory."""
    skip_without_blender()
    process = BlenderProcess(dict(os.environ))
    try:
        return process.call(job, arguments)
    finally:
        process.end()


def end_shared_blender() -> None:
    """End the process that calls of `in_blender` share, if there is one."""
    global _shared
    if _shared is not None:
        _shared.end()
    _shared = None


def serve(connection: Connection) -> None:
    """Do jobs until the other end is closed."""
    for job, arguments in _jobs(connection):
        gc.collect()
        bpy.ops.wm.read_factory_settings(use_empty=True)
        connection.send(_result(job, arguments))


def _jobs(connection: Connection) -> Iterator[tuple[str, tuple[Any, ...]]]:
    with contextlib.suppress(EOFError):
        while True:
            yield connection.recv()


def _result(job: str, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
    """Return whether a job is done, and what it returns, or its traceback."""
    module, function = job.split(".")
    try:
        call = getattr(importlib.import_module(f"blender_jobs.{module}"), function)
        return True, call(*arguments)
    except Exception:  # noqa: BLE001 - told to the test
        return False, traceback.format_exc()


if __name__ == "__main__":
    sys.path.append(str(Path(__file__).resolve().parents[2]))  # for tools.bench.cycles_passes
    import bpy  # comes before anything that loads Open3D

    from oaisys_grpc.worker.program import die_with_parent

    die_with_parent(int(sys.argv[2]))
    serve(Connection(int(sys.argv[1])))
