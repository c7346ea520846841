"""What a long computation is at: told to a listener, shown to a person."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.status import Status

ProgressCallback = Callable[[str], None]
"""Called with what is done now, such as ``views 3 of 30``."""

LINE_EVERY_S = 5.0


def ignore_progress(stage: str) -> None:
    """Do nothing with it."""


class ProgressDisplay:
    """Shows stages on standard error: on a terminal in one line that moves, else as plain lines.

    Use it in a ``with`` block and call it with each stage. A plain line is printed for the first
    stage, and for the newest one where the last line is `LINE_EVERY_S` old.
    """

    def __init__(
        self, what: str, say: Callable[[str], None] | None = None, console: Console | None = None
    ) -> None:
        """Prepare.

        Args:
            what: What is done, such as ``measuring``.
            say: Prints a plain line; None: on the console.
            console: Of standard error, unless another one is given.
        """
        self._what = what
        self._console = console or Console(stderr=True, highlight=False)
        self._say = say or self._print
        self._status = Status(what, console=self._console)
        self._said_s: float | None = None

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Take the moving line away."""
        self._status.stop()

    def __call__(self, stage: str) -> None:
        """Show a stage."""
        text = f"{self._what}: {stage}"
        if self._console.is_terminal:
            self._status.update(text)
            return
        now_s = time.monotonic()
        if self._said_s is None or now_s - self._said_s >= LINE_EVERY_S:
            self._said_s = now_s
            self._say(text)

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, soft_wrap=True)
