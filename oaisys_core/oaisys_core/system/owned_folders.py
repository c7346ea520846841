"""Folders for temporary files that are removed even after the process that made them was killed.

The owner keeps a file in its folder locked as long as it runs. A folder whose file nobody has
locked is abandoned, and removed by whoever looks next.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Self

LOOK_S = 0.01
"""Between two tries to lock the file of an owner that ends."""

_OWNED, _BEING_OWNED = "owner", "owner.new"
"""Names of the file that the folder's owner keeps locked as long as it runs."""


class OwnedFolder:
    """A new folder, removed by `remove` or by `remove_abandoned`; a context manager."""

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        """Make the folder.

        Args:
            prefix: How its name begins.
            parent: Where it is; None: where temporary files are.
        """
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        self._process = os.getpid()
        # It gets its name once it is locked, so that nobody takes the folder for abandoned.
        new = self.path / _BEING_OWNED
        self._lock = os.open(new, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        new.rename(self.path / _OWNED)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove it."""
        self.remove()

    def remove(self) -> None:
        """Remove the folder and its content; a second call does nothing, nor one of a fork."""
        if self._lock >= 0 and os.getpid() == self._process:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock)
            self._lock = -1


def remove_abandoned(prefix: str, parent: Path | None = None) -> None:
    """Remove the folders of killed processes of this user; see `OwnedFolder`."""
    for path in Path(parent or tempfile.gettempdir()).glob(f"{prefix}*"):
        remove_if_abandoned(path)


def remove_if_abandoned(folder: Path, wait_s: float = 0.0) -> None:
    """Remove an `OwnedFolder` of this user whose owner has ended; do nothing to any other.

    Args:
        folder: It.
        wait_s: Longest time to wait for the owner's end. The kernel tells of a process's end when
            its first thread has ended; its files stay locked until the last one has.
    """
    with contextlib.suppress(OSError), _lock_of_the_dead(folder, wait_s):
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _lock_of_the_dead(folder: Path, wait_s: float) -> Iterator[None]:
    """Lock a folder of this user once its owner has ended.

    Raises:
        OSError: It is another user's, or its owner lives.
    """
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
        raise PermissionError(folder)
    lock = os.open(folder / _OWNED, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        _lock_within(lock, wait_s)
        yield
    finally:
        os.close(lock)


def _lock_within(file: int, wait_s: float) -> None:
    """Lock a file, or raise `BlockingIOError` where another process still has it after a time."""
    end_s = time.monotonic() + wait_s
    while True:
        is_last = time.monotonic() >= end_s
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if is_last:
                raise
        else:
            return
        time.sleep(LOOK_S)
