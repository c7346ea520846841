"""What a command must not leave behind where it is ended: its unfinished files and its folders.

`oaisys` ends a long command by killing the process that works, see
`oaisys_core.system.ending.signals`. That process writes down here which files and folders of its
own exist for a while only; the process that kills it then removes them. Elsewhere, for instance in
a program that uses this package, nothing is written down.

The record is a file in memory without a name, which both processes share. Each path has a slot of
fixed size, so that a process which dies while it writes leaves the other slots as they are.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SLOT_BYTES = 4096
"""The longest path, and the 0 after it."""

_FREE = b"\0"


class Leftovers:
    """The record of one command."""

    def __init__(self) -> None:
        self._file = os.memfd_create("oaisys-leftovers", os.MFD_CLOEXEC)
        os.fchmod(self._file, 0o600)
        self._free: list[int] = []
        self._slots = 0
        self._lock = threading.Lock()

    def add(self, path: Path) -> int:
        """Write a path down, and return its slot."""
        data = os.fsencode(path.absolute())
        with self._lock:
            slot = self._free.pop() if self._free else self._slots
            self._slots = max(self._slots, slot + 1)
        os.pwrite(self._file, data[: SLOT_BYTES - 1].ljust(SLOT_BYTES, _FREE), slot * SLOT_BYTES)
        return slot

    def drop(self, slot: int) -> None:
        """Strike out a path."""
        os.pwrite(self._file, _FREE, slot * SLOT_BYTES)
        with self._lock:
            self._free.append(slot)

    def paths(self) -> list[Path]:
        """Return the paths that are written down."""
        size = os.fstat(self._file).st_size
        slots = (os.pread(self._file, SLOT_BYTES, at) for at in range(0, size, SLOT_BYTES))
        found = (slot.partition(_FREE)[0] for slot in slots)
        return [Path(os.fsdecode(each)) for each in found if each]

    def remove(self, kept: Path | None = None) -> None:
        """Remove what is written down and exists, but no folder that a living process has locked.

        Args:
            kept: A path that stays.
        """
        for path in self.paths():
            if path == kept or _is_locked(path):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with suppress(OSError):
                    path.unlink()


def _is_locked(folder: Path) -> bool:
    """Return whether a living process has locked a folder, which is its own then."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        return not try_lock(descriptor)
    finally:
        os.close(descriptor)


def try_lock(descriptor: int) -> bool:
    """Lock what a descriptor is of; return False if another one has, and True without locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass  # a file system without locks, where nobody takes it for a dead process's
    return True


_record: Leftovers | None = None


def record_leftovers(record: Leftovers) -> None:
    """Have this process write down in a record what it must not leave behind."""
    global _record
    _record = record


@contextmanager
def temporary_folder(prefix: str, parent: str | Path | None = None) -> Iterator[Path]:
    """Yield a new folder that is removed at the end of the block, or of the command.

    Args:
        prefix: How its name begins.
        parent: Where it is; None: where temporary files are.
    """
    # Written down before it is made, so that there is no moment in which it could stay.
    name = f"{prefix}{secrets.token_hex(4)}"
    folder = Path(tempfile.gettempdir() if parent is None else parent, name)
    with remove_when_killed(folder):
        folder.mkdir(mode=0o700)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def keep_temporary_files() -> None:
    """Have the temporary files of libraries removed at the end of the command, if it is recorded.

    Blender, for one, makes a folder when it is imported, and removes it when it ends by itself.
    """
    if _record is None:
        return
    folder = Path(tempfile.gettempdir(), f"oaisys-files-{secrets.token_hex(4)}")
    _record.add(folder)
    folder.mkdir(mode=0o700)
    os.environ["TMPDIR"] = str(folder)


@contextmanager
def remove_when_killed(path: Path) -> Iterator[Path]:
    """Yield a path that is not to be left where the process is killed within the block.

    The block itself removes it, or renames it, in every other case.
    """
    record = _record
    if record is None:
        yield path
        return
    slot = record.add(path)
    try:
        yield path
    finally:
        record.drop(slot)
