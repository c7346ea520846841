"""The folder for a worker's temporary files; it is removed even after its server was killed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

PREFIX = "oaisys-worker-"
_OWNED, _BEING_OWNED = "owner", "owner.new"
"""Names of the file that the folder's server keeps locked as long as it runs."""


class WorkerFolder:
    """A new folder, removed by `remove` or by the next server."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        # It gets its name once it is locked, so that nobody takes the folder for abandoned.
        new = self.path / _BEING_OWNED
        self._lock = os.open(new, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        new.rename(self.path / _OWNED)

    def remove(self) -> None:
        """Remove the folder and its content; a second call does nothing."""
        if self._lock >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock)
            self._lock = -1


def remove_abandoned() -> None:
    """Remove the folders of killed servers of this user."""
    for path in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError), _lock_of_the_dead(path):
            shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def _lock_of_the_dead(folder: Path) -> Iterator[None]:
    """Lock a folder of this user.

    Raises:
        OSError: It is another user's, or its server lives.
    """
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
        raise PermissionError(folder)
    lock = os.open(folder / _OWNED, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(lock)
