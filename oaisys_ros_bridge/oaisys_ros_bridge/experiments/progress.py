"""Shows the progress of a long command: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.table import Table

from oaisys_core.errors import InvalidInputError
from oaisys_core.system.progress_display import ProgressDisplay, show_stages

T = TypeVar("T")

FILE_COLUMNS = 160
"""Width of a table in a file: rich would take 80 columns there and shorten figures."""


STARTED_VARIABLE = "OAISYS_STARTED_S"
"""Environment variable with the start, in seconds since 1970, where it is not this process's."""

_START_FIELD = 19
"""Of ``/proc/PID/stat``, counted from 0 behind the name: the start, in ticks since the boot."""


def seconds_since_start() -> float:
    """Return the seconds since the time in `STARTED_VARIABLE`, or since this process started.

    Raises:
        InvalidInputError: The variable holds no number.
    """
    given = os.environ.get(STARTED_VARIABLE, "")
    if given:
        try:
            return time.time() - float(given)
        except ValueError:
            raise InvalidInputError(STARTED_VARIABLE, given, "seconds since 1970") from None
    fields = Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    started_s = int(fields[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_s


def print_table(table: Table) -> None:
    """Print a table on standard output; no figure is shortened."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=FILE_COLUMNS)
    console.print(table)


class Reporter:
    """Shows on standard error what a command does."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        self._started_s = time.monotonic()
        self._done, self._total, self._what = 0, 0, ""

    def say(self, sentence: str) -> None:
        """Print one line, with the seconds since the start."""
        elapsed_s = time.monotonic() - self._started_s
        self._console.print(f"[{elapsed_s:6.1f} s] {sentence}", markup=False, soft_wrap=True)

    def stages(self, what: str) -> AbstractContextManager[Callable[[str], None]]:
        """Return a display for the stages of a long computation; use it in a ``with`` block."""
        return show_stages(what, self.say, self._console)

    def track(self, items: Sequence[T], what: str) -> Iterator[T]:
        """Yield the items, showing how many are done."""
        self._done, self._total, self._what = 0, len(items), what
        with ProgressDisplay(what, len(items), console=self._console) as display:
            for item in items:
                yield item
                display.advance()

    def step(self, sentence: str) -> None:
        """Print a line on the tracked item, unless a bar is shown."""
        self._done += 1
        if not self._console.is_terminal:
            self.say(f"{self._what} {self._done}/{self._total}: {sentence}")
