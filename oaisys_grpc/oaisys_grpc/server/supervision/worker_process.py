"""One worker process as the server sees it: start it, call it, end it."""

from __future__ import annotations

import collections
import contextlib
import logging
import math
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import oaisys_core
import oaisys_grpc
from oaisys_core.errors import (
    BackendUnavailableError,
    CancelledError,
    DeadlineExceededError,
    WorkerLostError,
)
from oaisys_core.system.owned_folders import OwnedFolder
from oaisys_core.system.python_programs import python_command, python_environment
from oaisys_grpc.memory import resident_bytes
from oaisys_grpc.server.supervision.crashes import KilledWorkerError, OutgrownWorkerError
from oaisys_grpc.server.supervision.worker_limits import (
    MEGABYTE,
    CallLimit,
    ProcessorTime,
    Watchdog,
    oom_kills,
)
from oaisys_grpc.server.supervision.worker_log import WorkerLog
from oaisys_grpc.worker.protocol import Connection, WorkerMessage

_LOG = logging.getLogger(__name__)
FOLDER_PREFIX = "oaisys-worker-"
"""Of the folder for a worker's temporary files."""
RENDER_STATISTICS = "Fra:"
"""Prefix of the lines that Blender 4.5 prints as it renders; they would displace errors."""

CRASH = "Fatal Python error"
"""Prefix of what Python's faulthandler prints of a crash."""

_POLL_MS = 50
_MEMORY_PERIOD_S = 0.5
_LINES_KEPT = 40
_LINES_QUOTED = 5
_LONGEST_LINE = 10_000
_END_S = 1.0
_LAST_WORDS_S = 5.0
"""For a process that closed its connection to end by itself and print why."""

_OTHER_ENVIRONMENTS = ("LD_LIBRARY_PATH", "PYTHONHOME", "VIRTUAL_ENV", "CONDA_PREFIX")
"""Variables of this interpreter's environment; another interpreter must not inherit them."""


class WorkerProcess:
    """A running worker; one thread calls it at a time."""

    def __init__(self, python: str, log: WorkerLog, kill_bytes: float = math.inf) -> None:
        """Start the process.

        The calling thread must live as long as the worker: the kernel kills the worker with it.

        Args:
            python: Its interpreter.
            log: Keeps what it prints.
            kill_bytes: Resident memory at which it is killed within a call.

        Raises:
            BackendUnavailableError: ``python`` cannot be run.
        """
        # Blender's own temporary files would stay behind when it is killed.
        self._folder = OwnedFolder(FOLDER_PREFIX)
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = self._start(python, theirs.fileno())
        self._connection = Connection(ours)
        self._readable = select.poll()  # not select, which knows descriptors below 1024 only
        self._readable.register(ours, select.POLLIN)
        self._kill_bytes = kill_bytes
        self._memory_checked_s = 0.0
        self._oom_kills = 0
        self._calls = 0
        self._log = log
        self._lines: collections.deque[str] = collections.deque(maxlen=_LINES_KEPT)
        self._reader = threading.Thread(target=self._read_log, name="worker-log", daemon=True)
        self._reader.start()
        self._killed_because = ""
        self._watchdog = Watchdog(lambda: self.kill("it hung beyond its deadline"))

    def _start(self, python: str, descriptor: int) -> subprocess.Popen[bytes]:
        arguments = ["--fd", str(descriptor), "--parent", str(os.getpid())]
        command = python_command("oaisys_grpc.worker", *arguments, python=python)
        try:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=[descriptor],
                env={**worker_environment(python, os.environ), "TMPDIR": str(self._folder.path)},
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
        self, method: str, request: WorkerMessage, limit: CallLimit
    ) -> Iterator[WorkerMessage]:
        """Have the worker do something; yield what it sends meanwhile, and at last its answer.

        Args:
            method: See `oaisys_grpc.worker.calls.SimulationCalls`.
            request: Its head and content go with the call.
            limit: When the call must stop.

        Raises:
            WorkerLostError: The process died; the message quotes what it printed last.
            DeadlineExceededError: It did not answer, not even to a cancel; it was killed.
            CancelledError: Likewise, within the grace period of a cancelled call.
        """
        self._calls += 1
        number = self._calls
        self._oom_kills = oom_kills()
        since_told: ProcessorTime | None = None
        self._watchdog.arm(limit.remaining_s())
        try:
            head = {**request.head, "type": "call", "id": number, "method": method}
            self._connection.send(head, request.content)
            while True:
                if since_told is None and limit.must_stop():
                    self._connection.send({"type": "cancel", "id": number})
                    since_told = ProcessorTime(self.pid)
                if limit.must_kill(since_told):
                    self.discard()
                    raise _kill_error(method, limit)
                self._check_memory(method)
                if not self._readable.poll(_POLL_MS):
                    continue
                message = self._connection.receive()
                if message.head["id"] != number:
                    continue
                if message.type == "answer":
                    break
                yield message
        except (EOFError, OSError) as error:
            if limit.must_kill(since_told):
                self.discard()
                raise _kill_error(method, limit) from error
            raise self._loss_error(method) from error
        finally:
            self._watchdog.disarm()
        yield message

    def end(self) -> None:
        """Ask the process to end; kill it where it does not."""
        with contextlib.suppress(OSError):
            self._connection.send({"type": "end"})
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self.discard()

    def kill(self, reason: str = "") -> None:
        """Kill the process and all that it started; any thread may call this, and a call then ends.

        Args:
            reason: For the error of a call that is lost.
        """
        if reason and self.alive:
            self._killed_because = reason
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def discard(self) -> None:
        """Kill the process and release all that belongs to it."""
        self._watchdog.end()
        self.kill()
        self._process.wait()
        self._connection.close()
        self._folder.remove()

    def resident_bytes(self) -> int:
        """Return how much memory it holds."""
        return resident_bytes(self._process.pid)

    def _check_memory(self, method: str) -> None:
        now_s = time.monotonic()
        if now_s < self._memory_checked_s + _MEMORY_PERIOD_S:
            return
        self._memory_checked_s = now_s
        held = self.resident_bytes()
        if held > self._kill_bytes:
            self.discard()
            raise OutgrownWorkerError(
                f"{method}: the worker used {held / MEGABYTE:.0f} MB of memory, more than "
                f"{self._kill_bytes / MEGABYTE:.0f} MB, and was killed"
            )

    def _read_log(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            while raw := lines.readline(_LONGEST_LINE):
                line = raw.decode(errors="replace").rstrip()
                if line.startswith(RENDER_STATISTICS):
                    _LOG.debug("worker: %s", line)
                    continue
                self._lines.append(line)
                self._log.write(self._process.pid, line)
                _LOG.info("worker: %s", line)

    def _loss_error(self, method: str) -> WorkerLostError:
        """Return the error of a call whose worker has ended."""
        words = f"{method}: {self.last_words()}"
        if self._killed_because or self._process.returncode != -signal.SIGKILL:
            return WorkerLostError(words)
        if oom_kills() > self._oom_kills:
            return OutgrownWorkerError(words)
        return KilledWorkerError(words)

    def last_words(self) -> str:
        """Return how the process ended and what it printed last."""
        with contextlib.suppress(subprocess.TimeoutExpired):  # our own signal would hide its end
            self._process.wait(_LAST_WORDS_S)
        if self.alive:
            self._killed_because = "it closed its connection, but went on"
        self.discard()
        self._reader.join(_END_S)
        lines = _telling(list(self._lines))
        said = "; it said last: " + " | ".join(lines) if lines else ""
        return f"the worker {self._how_it_ended()}{said}"

    def _how_it_ended(self) -> str:
        """Return how the process ended."""
        if self._killed_because:
            return f"was killed by its server: {self._killed_because}"
        code = self._process.returncode
        if code >= 0:
            return f"exited with {code}"
        name = signal.Signals(-code).name
        by_others = " (sent by the system, for want of memory, or by a user)"
        return f"was ended by {name}{by_others if -code == signal.SIGKILL else ''}"


def _telling(lines: list[str]) -> list[str]:
    """Return the lines that tell why a process ended: a crash's traceback, or the last lines."""
    crashes = [i for i, line in enumerate(lines) if line.startswith(CRASH)]
    if not crashes:
        return lines[-_LINES_QUOTED:]
    traceback = [line.strip() for line in lines[crashes[-1] :] if line.strip()]
    return traceback[:_LINES_QUOTED]


def _kill_error(method: str, limit: CallLimit) -> CancelledError | DeadlineExceededError:
    if limit.is_cancelled:
        return CancelledError(f"{method} was cancelled, and its worker replaced")
    return DeadlineExceededError(f"{method} hung beyond its deadline; worker killed")


def worker_environment(python: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables for a worker with the interpreter ``python``.

    Another interpreter gets none of this one's environment, or it would load its ROS libraries and
    packages. Both find this project's packages.
    """
    wanted = python_environment(environment)
    folders = {str(Path(file).parents[1]) for file in (oaisys_core.__file__, oaisys_grpc.__file__)}
    # A folder with numpy belongs to one interpreter; another cannot use its compiled modules.
    paths = sorted(folder for folder in folders if not Path(folder, "numpy").exists())
    if Path(python).absolute() == Path(sys.executable).absolute():
        paths += filter(None, [wanted.get("PYTHONPATH")])
    else:
        for name in environment:
            if name in _OTHER_ENVIRONMENTS or name.startswith(("AMENT_", "_ROS_WHEELS_")):
                del wanted[name]
    wanted["PYTHONPATH"] = os.pathsep.join(paths)
    wanted["PYTHONUNBUFFERED"] = "1"
    return wanted
