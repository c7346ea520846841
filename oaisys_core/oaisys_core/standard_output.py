"""Standard output without what libraries print there."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def own_stdout() -> Iterator[None]:
    """Keep standard output for what Python writes: Blender 4.5 prints a line for each tile there.

    Libraries' own output goes to standard error where details are logged, else nowhere.
    """
    sys.stdout.flush()
    shows_all = logging.getLogger().isEnabledFor(logging.DEBUG)
    aside = os.dup(2) if shows_all else os.open(os.devnull, os.O_WRONLY)
    kept, python = os.dup(1), sys.stdout
    os.dup2(aside, 1)
    os.close(aside)
    sys.stdout = open(kept, "w", encoding="utf-8", buffering=1, closefd=False)  # noqa: SIM115
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stdout = python
        os.dup2(kept, 1)
        os.close(kept)
