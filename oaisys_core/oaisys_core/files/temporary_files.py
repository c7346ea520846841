"""Temporary files beside a target, each of one writer alone, whoever may write to the folder.

The file is in a folder of mode 0700, and its path leads through that folder's descriptor: others
may rename the folder, but can put nothing in its place. The folder is locked as long as its writer
lives. The next writer of the same target removes what killed ones left.
"""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from oaisys_core.system.ending.leftovers import remove_when_killed, try_lock

WRITERS = 4
"""How many writers of one target have folders whose names the next writer looks up."""

_MORE_TRIES = 16
_NAME_BYTES = 230
_OTHERS_WRITE = 0o022
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_NEW_FILE = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def temporary_file(target: Path) -> Iterator[Path]:
    """Yield the path of a new empty file on the target's file system, with its suffix.

    It is to be renamed within the block, or is removed. The path is one of this process alone.

    Raises:
        OSError: It could not be made.
    """
    # Of a long name the end, which has the suffix: with these letters more it would be no name.
    end = os.fsencode(target.name)[-_NAME_BYTES:].decode(errors="ignore")
    name = f".part-{end}"
    for folder in _known_folders(target):
        _remove_dead(folder, name)
    for folder in _folders(target):
        with remove_when_killed(folder):
            try:
                descriptor = _make_own(folder, name)
            except OSError as error:
                # The temporary name would tell nobody anything.
                raise OSError(error.errno, error.strerror, str(target)) from error
            if descriptor is None:
                continue
            try:
                yield Path(f"/proc/self/fd/{descriptor}", name)
            finally:
                _remove_own(folder, descriptor)
            return
    raise OSError(errno.EBUSY, "others take its temporary names", str(target))


def _known_folders(target: Path) -> list[Path]:
    name = _short_name(target)
    numbers = ["", *(f".{number}" for number in range(1, WRITERS))]
    return [target.with_name(f".{name}{number}.part") for number in numbers]


def _folders(target: Path) -> Iterator[Path]:
    yield from _known_folders(target)
    for _ in range(_MORE_TRIES):
        yield target.with_name(f".{_short_name(target)}.{secrets.token_hex(4)}.part")


def _short_name(target: Path) -> str:
    """Return the target's name, cut where one with more letters would be no name."""
    return os.fsencode(target.name)[:_NAME_BYTES].decode(errors="ignore")


def _make_own(folder: Path, name: str) -> int | None:
    """Make a folder with an empty file; None if the folder is, or becomes, somebody else's."""
    try:
        folder.mkdir(0o700)
    except FileExistsError:
        return None
    try:
        descriptor = os.open(folder, _FOLDER)
    except OSError as error:
        _remove_empty(folder)
        if error.errno in {errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.EACCES}:
            return None  # removed or replaced in between
        raise
    try:
        # Another writer may have locked it, which took it for a dead one's.
        if try_lock(descriptor) and _make_file(descriptor, name):
            return descriptor
    except OSError:
        _remove_own(folder, descriptor)
        raise
    os.close(descriptor)
    _remove_empty(folder)
    return None


def _make_file(descriptor: int, name: str) -> bool:
    """Make an empty file in an empty folder; return False if the folder is another's."""
    if os.listdir(descriptor):
        return False
    try:
        file = os.open(name, _NEW_FILE, 0o666, dir_fd=descriptor)
    except (FileNotFoundError, FileExistsError, PermissionError):
        return False  # the folder was removed, or replaced
    owner = os.fstat(file).st_uid
    os.close(file)
    # Compared with the file's, because some file systems say one owner of everything.
    if os.fstat(descriptor).st_uid == owner and not _is_writable_by_others(descriptor):
        return True
    with suppress(OSError):
        os.unlink(name, dir_fd=descriptor)
    return False


def _is_writable_by_others(descriptor: int) -> bool:
    """Return whether a folder has another mode than a new private one, so that it is not ours."""
    if not os.fstat(descriptor).st_mode & _OTHERS_WRITE:
        return False
    # Some file systems give all folders one mode, a new one too.
    name = secrets.token_hex(4)
    os.mkdir(name, 0o700, dir_fd=descriptor)
    mode = os.stat(name, dir_fd=descriptor, follow_symlinks=False).st_mode
    os.rmdir(name, dir_fd=descriptor)
    return not mode & _OTHERS_WRITE


def _remove_own(folder: Path, descriptor: int) -> None:
    """Remove this writer's folder, and release its lock."""
    with suppress(OSError):
        for name in os.listdir(descriptor):
            os.unlink(name, dir_fd=descriptor)
    _remove_empty(folder)
    os.close(descriptor)


def _remove_dead(folder: Path, name: str) -> None:
    """Remove the folder of a killed writer of this user, and its file."""
    try:
        descriptor = os.open(folder, _FOLDER)
    except OSError:
        return
    with suppress(OSError):
        if os.fstat(descriptor).st_uid == os.geteuid():
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):
                os.unlink(name, dir_fd=descriptor)
            folder.rmdir()
    os.close(descriptor)


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()
