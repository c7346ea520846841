"""One worker process as the server sees it: start it, call it, end it."""

from __future__ import annotations

import collections
import contextlib
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import oaisys_core
import oaisys_grpc
from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    DeadlineExceededError,
    WorkerLostError,
)
from oaisys_core.types import Progress
from oaisys_grpc.wire import Connection, Message

_LOG = logging.getLogger(__name__)
RENDER_STATISTICS = "Fra:"
"""Begins the lines that Blender 4.5 prints as it renders; they would push out what went wrong."""

_POLL_S = 0.05
_LINES_KEPT = 20
_END_S = 2.0
_FOLDER = "oaisys-worker-"
_OTHER_ENVIRONMENTS = ("LD_LIBRARY_PATH", "PYTHONHOME", "VIRTUAL_ENV", "CONDA_PREFIX")
"""Of this interpreter's environment; another interpreter must not get them."""


class WorkerProcess:
    """A running worker; one thread calls it at a time."""

    def __init__(self, python: str) -> None:
        """Start the process; the calling thread must live as long as the worker shall.

        The kernel ends a worker with the thread that started it.

        Raises:
            BackendUnavailableError: ``python`` cannot be run.
        """
        # Blender's own temporary files would stay behind when it is killed.
        self._folder = tempfile.TemporaryDirectory(prefix=_FOLDER, ignore_cleanup_errors=True)
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = self._start(python, theirs.fileno())
        self._connection = Connection(ours)
        self._calls = 0
        self._lines: collections.deque[str] = collections.deque(maxlen=_LINES_KEPT)
        self._log = threading.Thread(target=self._read_log, name="worker-log", daemon=True)
        self._log.start()

    def _start(self, python: str, descriptor: int) -> subprocess.Popen[bytes]:
        command = [python, "-m", "oaisys_grpc.worker"]
        command += ["--fd", str(descriptor), "--parent", str(os.getpid())]
        try:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[descriptor],
                env={**worker_environment(python, os.environ), "TMPDIR": self._folder.name},
                process_group=0,
            )
        except OSError as error:
            raise BackendUnavailableError(f"cannot start a worker: {error}") from error

    @property
    def pid(self) -> int:
        """The worker's process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def call(
        self,
        method: str,
        arguments: Mapping[str, Any],
        *,
        limit: Limit,
        progress: Callable[[Progress], None],
    ) -> Message:
        """Have the worker do something and return its answer.

        Raises:
            WorkerLostError: The process died; the message says what it said last.
            DeadlineExceededError: It did not answer, not even to a cancel; it was killed.
        """
        self._calls += 1
        number = self._calls
        told = False
        try:
            call = {"type": "call", "id": number, "method": method, "arguments": arguments}
            self._connection.send(call)
            while True:
                if not told and limit.must_stop():
                    self._connection.send({"type": "cancel", "id": number})
                    told = True
                if limit.must_kill():
                    self.kill()
                    raise DeadlineExceededError(f"{method} hung beyond its deadline; worker killed")
                if not select.select([self._connection], [], [], _POLL_S)[0]:
                    continue
                message = self._connection.receive()
                if message["id"] != number:
                    continue
                if message["type"] == "answer":
                    return message
                progress(Progress(message["stage"], message["fraction"]))
        except (EOFError, OSError) as error:
            raise WorkerLostError(f"{method}: {self.last_words()}") from error

    def end(self) -> None:
        """Ask the process to end; kill it where it does not."""
        with contextlib.suppress(OSError):
            self._connection.send({"type": "end"})
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self.kill()

    def strike(self) -> None:
        """Kill the process, and all that it started; any thread may, a call then ends."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def kill(self) -> None:
        """Kill the process and forget it."""
        self.strike()
        self._process.wait()
        self._connection.close()
        self._folder.cleanup()

    def _read_log(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for raw in lines:
                line = raw.decode(errors="replace").rstrip()
                if line.startswith(RENDER_STATISTICS):
                    _LOG.debug("worker: %s", line)
                    continue
                self._lines.append(line)
                _LOG.info("worker: %s", line)

    def last_words(self) -> str:
        """Return how the process ended and what it said last."""
        self.kill()
        self._log.join(_END_S)
        code = self._process.returncode
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"exited with {code}"
        said = "; it said last: " + " | ".join(list(self._lines)[-5:]) if self._lines else ""
        return f"the worker {how}{said}"


class Limit:
    """When a call must stop: when its owner says so, or when its time is over.

    A worker that does not stop within a grace period after its deadline is killed; one that was
    only cancelled keeps its time, because a new worker would cost more.
    """

    def __init__(self, timeout_s: float, grace_s: float, cancelled: threading.Event) -> None:
        self._deadline_s = time.monotonic() + timeout_s
        self._grace_s = grace_s
        self._cancelled = cancelled

    @property
    def over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._deadline_s

    def must_stop(self) -> bool:
        """Whether the call must be cancelled."""
        return self._cancelled.is_set() or self.over

    def must_kill(self) -> bool:
        """Whether the worker had its chance."""
        return time.monotonic() >= self._deadline_s + self._grace_s

    def error(self) -> CancelledError | DeadlineExceededError:
        """Return why the call was stopped."""
        if self._cancelled.is_set():
            return CancelledError("cancelled by the caller")
        return DeadlineExceededError("the operation did not end within its deadline")


def worker_environment(python: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables for a worker with the interpreter ``python``.

    Another interpreter gets nothing that belongs to this one's environment: its ROS libraries and
    packages would be loaded there. Both find this project's packages.
    """
    wanted = dict(environment)
    folders = {str(Path(file).parents[1]) for file in (oaisys_core.__file__, oaisys_grpc.__file__)}
    # A folder that holds numpy is an interpreter's own: no other can use its compiled modules.
    paths = sorted(folder for folder in folders if not Path(folder, "numpy").exists())
    if Path(python).absolute() == Path(sys.executable).absolute():
        paths += filter(None, [environment.get("PYTHONPATH")])
    else:
        for name in environment:
            if name in _OTHER_ENVIRONMENTS or name.startswith(("AMENT_", "_ROS_WHEELS_")):
                del wanted[name]
    wanted["PYTHONPATH"] = os.pathsep.join(paths)
    wanted["PYTHONUNBUFFERED"] = "1"
    return wanted
