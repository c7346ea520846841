"""Says where shared memory is full or planted, in which ROS would end or hang without a word."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from oaisys_core.errors import OaisysError, ShortageError

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - Linux's name for it
LOADING_BYTES = 16 * 2**10
"""What LTTng, which rclpy loads, needs there at least: two files of a page, and some room."""

FIRST_PORT, PORTS_OF_DOMAIN = 7400, 250
"""Port of the first ROS domain, and ports of each (RTPS 2.2, 9.6.1.1). Fast DDS opens lower ones
in all domains."""

_PORT = re.compile(r"(?:sem\.)?fastrtps_port(\d+)(?:_el|_sl|_mutex)?")
"""Names of Fast DDS's files for a port: the port itself, two locks, and a mutex."""


def require_shared_memory(folder: Path = SHARED_MEMORY) -> None:
    """Do nothing where rclpy can be loaded; call it before that.

    LTTng reads files that it has made there; where they get no memory, that is a SIGBUS. Where they
    have it, because this user has run a node before, rclpy and Fast DDS work in a full folder, too.

    Raises:
        ShortageError: The folder is full.
        OaisysError: A pipe has the name of a file that LTTng opens, and waits for its other end.
    """
    for path in folder.glob("lttng-ust-wait-*"):
        if path.is_fifo():
            raise OaisysError(f"{path} is a pipe, at which whatever loads ROS waits: remove it")
    if not folder.is_dir() or shutil.disk_usage(folder).free >= LOADING_BYTES:
        return
    files = folder.glob(f"lttng-ust-wait-*-{os.getuid()}")
    if not any(file.stat().st_blocks for file in files):
        raise ShortageError(f"{folder} is full: ROS cannot be loaded without shared memory")


def require_safe_ports(domain: int, folder: Path = SHARED_MEMORY) -> None:
    """Do nothing where no other user has planted what Fast DDS opens for a ROS domain's ports.

    It follows links there, and waits for ever for the mutex of a port that nobody has made.

    Raises:
        OaisysError: A link, or a port of another user that no program of theirs holds.
    """
    for path, mode in _foreign_ports((range(FIRST_PORT), _ports_of(domain)), folder):
        # What this user may not write to, Fast DDS does not use either.
        if not stat.S_ISREG(mode) or (os.access(path, os.W_OK) and not _is_held(path)):
            raise OaisysError(
                f"{path} is a link or another user's, and no program of theirs uses it: remove it,"
                " or set another ROS_DOMAIN_ID"
            )


def foreign_ports(domain: int, folder: Path = SHARED_MEMORY) -> list[Path]:
    """Return links and what others than this user have under names of a ROS domain's ports."""
    return [path for path, _ in _foreign_ports((_ports_of(domain),), folder)]


def _ports_of(domain: int) -> range:
    first = FIRST_PORT + PORTS_OF_DOMAIN * domain
    return range(first, first + PORTS_OF_DOMAIN)


def _foreign_ports(ports: Sequence[range], folder: Path) -> Iterator[tuple[Path, int]]:
    """Yield what is under names of some ports, and its mode, as in `foreign_ports`."""
    for path in folder.iterdir() if folder.is_dir() else ():
        found = _PORT.fullmatch(path.name)
        if found and any(int(found[1]) in each for each in ports):
            with suppress(FileNotFoundError):  # its program has ended since
                status = path.lstat()
                if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid():
                    yield path, status.st_mode


def _is_held(path: Path) -> bool:
    """Return whether a program that listens to a file's port holds its lock, as Fast DDS does."""
    found = _PORT.fullmatch(path.name)
    assert found is not None
    for kind in ("_el", "_sl"):
        lock = path.with_name(f"fastrtps_port{found[1]}{kind}")
        with suppress(OSError):
            descriptor = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
            finally:
                os.close(descriptor)
    return False
