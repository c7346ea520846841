"""Leaves the current folder while libraries load that look for parts of their own there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def in_root_folder() -> Iterator[None]:
    """Make ``/`` the current folder of this process within the block.

    Only its administrator puts anything there; whoever else owns the current folder could.
    """
    here = os.open(".", os.O_PATH | os.O_CLOEXEC)
    try:
        os.chdir("/")
        yield
    finally:
        os.fchdir(here)
        os.close(here)
