"""What another program has printed, as an error quotes it: its last lines, each of bounded length.

Programs of others may print gigabytes, in one line too, and characters that command a terminal.
"""

from __future__ import annotations

import os
from pathlib import Path

from oaisys_core.system.standard_streams import printable

READ_BYTES = 1_000_000
"""Of the end of a log, which are read."""
LONGEST_LINE = 300
"""Characters."""


def last_lines(log: Path) -> list[str]:
    """Return the last `READ_BYTES` of a log as `printable_lines`; none where it cannot be read."""
    try:
        with log.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(file.tell() - READ_BYTES, 0))
            found = file.read(READ_BYTES)
    except OSError:
        return []
    return printable_lines(found.decode(errors="replace"))


def printable_lines(text: str) -> list[str]:
    """Return the lines of a text as they can be shown: printable, and of bounded length."""
    return [_shown(line) for line in text.splitlines()]


def _shown(line: str) -> str:
    shown = printable(line[: LONGEST_LINE + 1])
    return shown if len(shown) <= LONGEST_LINE else f"{shown[: LONGEST_LINE - 3]}..."
