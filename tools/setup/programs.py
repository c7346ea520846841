"""Programs that the set-up starts: their progress is shown, and they end when the set-up ends."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from tools.setup.errors import SetupError

LINE_EVERY_S = 5.0
BAR_EVERY_S = 0.5
_BAR_WIDTH = 20

_OWNER = Path(__file__).parents[2] / "oaisys_core/oaisys_core/system/ending/owner.py"
_WITH_OWNER = (sys.executable, "-I", "-S", str(_OWNER))
"""Has a program end if the set-up is killed; by its file, as nothing is installed yet."""


@dataclass(frozen=True)
class ProgramProgress:
    """How far a program is.

    Attributes:
        text: Description for the user.
        share: Finished part of the work, from 0 to 1.
    """

    text: str
    share: float


class Display:
    """Shows the set-up's lines: a bar below them on a terminal, a line of progress elsewhere.

    Any thread may call it.
    """

    def __init__(self, stream: TextIO | None = None, every_s: float | None = None) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._is_terminal = self._stream.isatty()
        self.every_s = every_s or (BAR_EVERY_S if self._is_terminal else LINE_EVERY_S)
        self._lock = threading.Lock()

    def say(self, text: str) -> None:
        """Print a line; the bar, if there is one, moves below it at its next update."""
        with self._lock:
            self._write(f"{self._erase()}setup: {text}\n")

    def show(self, progress: ProgramProgress, elapsed_s: float) -> None:
        """Show how far a program is."""
        with self._lock:
            if not self._is_terminal:
                self._write(f"setup:   {progress.text}, {elapsed_s:.0f} s\n")
                return
            done = round(min(max(progress.share, 0.0), 1.0) * _BAR_WIDTH)
            bar = "#" * done + "." * (_BAR_WIDTH - done)
            line = f"setup: [{bar}] {progress.text}, {elapsed_s:.0f} s"
            self._write(self._erase() + line[: shutil.get_terminal_size().columns - 1])

    def _erase(self) -> str:
        return "\r\x1b[K" if self._is_terminal else ""

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


class Programs:
    """Owner of the programs that run for the set-up; several threads may start one each."""

    def __init__(self, display: Display) -> None:
        self.display = display
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._stopped = False

    def run(
        self,
        command: Sequence[str | Path],
        variables: Mapping[str, str],
        log: Path,
        progress: Callable[[str], ProgramProgress] | None = None,
        timeout_s: float = float("inf"),
    ) -> int:
        """Run a program to its end, and show its progress every few seconds.

        Args:
            command: The program and its arguments.
            variables: Its environment variables.
            log: File for its output.
            progress: Describes the progress, given the output so far.
            timeout_s: Seconds after which it is killed.

        Returns:
            Its exit code; negative if a signal ended it.

        Raises:
            OSError: The program cannot be started.
            SetupError: The set-up is being stopped.
        """
        started_s = time.monotonic()
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("w") as output:
            process = self._start(command, variables, output)
        try:
            while process.poll() is None:
                elapsed_s = time.monotonic() - started_s
                if elapsed_s >= timeout_s:
                    break
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(min(self.display.every_s, timeout_s - elapsed_s))
                    break
                if progress is not None:
                    said = log.read_text(errors="replace")
                    self.display.show(progress(said), time.monotonic() - started_s)
        finally:
            _kill(process)
            code = process.wait()
            with self._lock:
                self._running.discard(process)
        if self._stopped:
            raise SetupError("stopped")
        return code

    def stop(self) -> None:
        """Kill what runs, and let nothing start any more."""
        with self._lock:
            self._stopped = True
            for process in self._running:
                _kill(process)

    def _start(
        self, command: Sequence[str | Path], variables: Mapping[str, str], output: TextIO
    ) -> subprocess.Popen[bytes]:
        with self._lock:
            if self._stopped:
                raise SetupError("stopped")
            # In a session of its own, so that its children can be ended with it.
            process = subprocess.Popen(
                [*_WITH_OWNER, str(os.getpid()), str(int(signal.SIGTERM)), *command],
                env=dict(variables),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
            self._running.add(process)
            return process


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
