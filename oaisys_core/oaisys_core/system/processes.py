"""Child processes that have a deadline to start and are always ended."""

from __future__ import annotations

import contextlib
import logging
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from oaisys_core.errors import DeadlineExceededError, WorkerLostError
from oaisys_core.system.ending.owner import owner_variables
from oaisys_core.system.ending.signals import defer_signals
from oaisys_core.system.private_files import open_private
from oaisys_core.system.program_output import READ_BYTES, last_lines
from oaisys_core.system.python_programs import python_environment

_LOG = logging.getLogger(__name__)

END_TIMEOUT_S = 20.0
"""From SIGINT to SIGABRT; a recorder closes its bag in between."""
LAST_WORDS_S = 2.0
"""From SIGABRT to SIGKILL; a node writes to its log where its threads are."""
QUOTED_LINES = 15
"""Last lines of a log that an error quotes."""


class ManagedProcess:
    """A program in a session of its own; a context manager.

    Leaving the block sends SIGINT to the program, then SIGKILL to its whole session. A program that
    has not ended by then is told of in a warning. If this process is killed, the program, which
    must be one of ours, ends at SIGTERM.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str],
        *,
        logs_output: bool = False,
    ) -> None:
        """Start ``command``, with its standard error in the file ``log``.

        Args:
            name: In errors.
            command: The program and its arguments.
            log: A file of this user alone.
            environment: Of the program.
            logs_output: Whether its standard output goes there, too, and no line is waited for.
        """
        self.name = name
        self._log = log
        self._is_interrupted = False
        log.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(open_private(log, os.O_WRONLY | os.O_TRUNC), "wb") as output:
            # In a session of its own: Ctrl-C at the terminal reaches the parent alone, which ends
            # its children in order.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output if logs_output else subprocess.PIPE,
                stderr=output,
                env=python_environment(environment) | owner_variables(),
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        """Return the running process."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it; a second signal does not interrupt that."""
        with defer_signals():
            self.end()

    def wait_for_line(self, prefix: str, timeout_s: float) -> str:
        """Wait for a line of standard output that begins with ``prefix``; return the rest of it.

        Raises:
            WorkerLostError: The process ended before; quotes its log.
            DeadlineExceededError: No such line came in time.
        """
        output = self._process.stdout
        assert output is not None
        deadline = time.monotonic() + timeout_s
        pending = b""
        with selectors.DefaultSelector() as selector:
            selector.register(output, selectors.EVENT_READ)
            while (left_s := deadline - time.monotonic()) > 0:
                if not selector.select(left_s):
                    break
                chunk = os.read(output.fileno(), 4096)
                if not chunk:
                    self._process.wait(END_TIMEOUT_S)
                    self.check()
                    break
                pending += chunk
                *lines, pending = pending[-READ_BYTES:].split(b"\n")
                for line in lines:
                    text = line.decode(errors="replace")
                    if text.startswith(prefix):
                        return text.removeprefix(prefix).strip()
        raise DeadlineExceededError(
            f"{self.name} did not print {prefix!r} within {timeout_s:g} s{self._quote_log()}"
        )

    @property
    def exit_code(self) -> int | None:
        """The process's exit code; None: it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Raise `WorkerLostError` where the process has ended; quotes its log."""
        code = self._process.poll()
        if code is not None:
            raise WorkerLostError(f"{self.name} ended with exit code {code}{self._quote_log()}")

    def interrupt(self) -> None:
        """Send SIGINT, once, if the process still runs; `end` waits for its end."""
        if not self._is_interrupted and self._process.poll() is None:
            self._is_interrupted = True
            self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """End the process and all others in its session."""
        self.interrupt()
        if not self._has_ended(END_TIMEOUT_S):
            _LOG.warning(
                "%s has not ended within %g s and is killed; its log: %s",
                self.name,
                END_TIMEOUT_S,
                self._log,
            )
            self._process.send_signal(signal.SIGABRT)
            self._has_ended(LAST_WORDS_S)
            # Ends what others' programs have started, see `command_with_descendants`.
            self._process.terminate()
            self._has_ended(LAST_WORDS_S)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _has_ended(self, timeout_s: float) -> bool:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        return self._process.poll() is not None

    def _quote_log(self) -> str:
        return "".join(f"\n  | {line}" for line in last_lines(self._log)[-QUOTED_LINES:])
