"""What the processes of a test leave behind: themselves, shared memory, ports, temporary files."""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from pathlib import Path
from typing import Any, Self

import psutil

MARK = "OAISYS_TEST_PROCESS"
"""Variable that marks the processes of a test."""

PATIENCE_S = 5.0
"""For processes to end, and for the system to close what they had open."""

_LOOK_PERIOD_S = 0.3
_PAUSE_S = 0.05
_CLOCKS_DIFFER_S = 5.0
"""Bound of the difference between the kernel's clock and the system's."""
_LISTENS = "0A"
"""State of a listening socket in the kernel's tables."""
_SOCKET = re.compile(r"socket:\[(\d+)\]")
_SHARED = re.compile(r"/dev/shm/(?:fastrtps_[0-9a-f]{16}|.*oaisys.*)")
"""Of the middleware only what belongs to one process: ports are shared by all of the machine."""


class LeakCheck:
    """Watches all processes with a mark; a context manager."""

    def __init__(self, mark: str) -> None:
        self._mark = mark
        self._processes: set[psutil.Process] = set()
        self._shared: set[str] = set()
        self._foreign: set[str] = set()
        self._sockets: set[int] = set()
        self._files: set[str] = set()
        self._began_s = 0.0
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="leak-check", daemon=True)

    def __enter__(self) -> Self:
        self._began_s = time.time()
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._watcher.join()

    def left_behind(self) -> list[str]:
        """End every process that still runs, and return what should not be there."""
        self._processes.update(marked_processes(self._mark))
        _, waited_for = psutil.wait_procs(
            [p for p in self._processes if _runs(p)], timeout=PATIENCE_S
        )
        running = [process for process in waited_for if _runs(process)]
        left = [f"process: {_command(process)}" for process in running]
        for process in running:
            process.kill()
        left += [
            f"shared memory: {file}{_users(file)}"
            for file in self._shared
            if Path(file).exists() and not _is_mapped_by_another_worker(file)
        ]
        left += [f"socket: {file}" for file in self._files if Path(file).exists()]
        return left + [f"port: {port}{_holders(inode)}" for inode, port in self._listen().items()]

    def _listen(self) -> dict[int, int]:
        """Return which ports the test still listens on, by inode; wait until there are none.

        On a busy machine, a killed process is gone before the system has closed its sockets.
        """
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            left = {inode: port for inode, port in listening().items() if inode in self._sockets}
            if not left or time.monotonic() > deadline_s:
                return left
            time.sleep(_PAUSE_S)

    def _watch(self) -> None:
        while not self._ended.wait(_LOOK_PERIOD_S):
            listened = listening().keys()
            for process in marked_processes(self._mark, self._began_s):
                self._processes.add(process)
                with contextlib.suppress(psutil.Error, OSError):
                    self._sockets |= _open_sockets(process) & listened
                    self._note(process)

    def _note(self, process: psutil.Process) -> None:
        for line in Path(f"/proc/{process.pid}/maps").read_text().splitlines():
            found = _SHARED.search(line.removesuffix(" (deleted)"))
            if found and found[0] not in self._shared | self._foreign:
                foreign = self._is_foreign(found[0], process)
                (self._foreign if foreign else self._shared).add(found[0])
        connections: list[Any] = process.net_connections("unix")
        addresses = {c.laddr for c in connections if isinstance(c.laddr, str)}
        self._files |= {address for address in addresses if address.startswith("/")}

    def _is_foreign(self, segment: str, user: psutil.Process) -> bool:
        """Tell whether a process of another ROS domain owns what a process of the test has mapped.

        It happens: Fast DDS takes the port for its graph's messages (`fastrtps_port7000` and on)
        from one range for all domains. Whoever gets the port of a process that ended is sent what
        that one's peers still send to it, and then maps their segments. What nobody owns, and
        what this process owns, is the test's.
        """
        owner = _owner_of(segment)
        if owner is None or owner.pid == os.getpid() or _mark_of(owner) == self._mark:
            return False
        try:
            domains = {process.environ().get("ROS_DOMAIN_ID") for process in (owner, user)}
        except psutil.Error:
            return False
        return len(domains) > 1


def marked_processes(mark: str, since_s: float = 0.0) -> list[psutil.Process]:
    """Return the processes of the test with this mark, orphans included, but not this one.

    Those that are older than ``since_s``, seconds since the epoch, are not asked.
    """
    return [
        process
        for process in psutil.process_iter()
        if _age_allows(process, since_s)
        and _mark_of(process) == mark
        and process.pid != os.getpid()
    ]


def _age_allows(process: psutil.Process, since_s: float) -> bool:
    """Tell whether a process may have begun after a time; what is asked for again is not read."""
    try:
        return bool(process.create_time() > since_s - _CLOCKS_DIFFER_S)
    except psutil.Error:
        return False


def listening() -> dict[int, int]:
    """Return the ports on which anybody listens, by the inode of the socket.

    The port itself may soon be another process's.
    """
    lines = [
        line.split()
        for table in ("tcp", "tcp6")
        if (path := Path(f"/proc/net/{table}")).exists()
        for line in path.read_text().splitlines()[1:]
    ]
    # Number, local address, remote address, state, ..., and the inode as the tenth.
    return {int(of[9]): int(of[1].rpartition(":")[2], 16) for of in lines if of[3] == _LISTENS}


def _open_sockets(process: psutil.Process) -> set[int]:
    """Return the inodes of a process's sockets."""
    found = set()
    for descriptor in Path(f"/proc/{process.pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            if match := _SOCKET.fullmatch(str(descriptor.readlink())):
                found.add(int(match[1]))
    return found


def _holders(inode: int) -> str:
    """Return who has a socket open."""
    holders = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if inode in _open_sockets(process):
                holders.append(f"{process.pid} {_command(process)[:200]}")
    return f", held by {holders}" if holders else ""


def _users(file: str) -> str:
    """Return who has a file mapped, and in which test and ROS domain; empty: nobody."""
    users = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if _maps(process, file):
                environment = process.environ()
                domain = environment.get("ROS_DOMAIN_ID")
                users.append(
                    f"{process.pid} {_command(process)[:200]} ({environment.get(MARK)}, {domain})"
                )
    return f", used by {users}" if users else ""


def _is_mapped_by_another_worker(file: str) -> bool:
    """Return whether another worker of pytest has a file mapped: a node in it still runs.

    Its domain is not in its environment as it began, and its lock may be gone before its file.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return False
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.ppid() == os.getppid() and _maps(process, file):
                return True
    return False


def _maps(process: psutil.Process, file: str) -> bool:
    return file in Path(f"/proc/{process.pid}/maps").read_text()


def _owner_of(segment: str) -> psutil.Process | None:
    """Return the process of a segment of Fast DDS: it locks a file beside it while it runs."""
    try:
        lock = Path(f"{segment}_el").stat()
        file = f"{os.major(lock.st_dev):02x}:{os.minor(lock.st_dev):02x}:{lock.st_ino}"
        held = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
        # Number, kind, mode, access, process, file; who waits has an arrow after the number.
        return next((psutil.Process(int(h[4])) for h in held if h[5] == file), None)
    except (psutil.Error, OSError):
        return None


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def _mark_of(process: psutil.Process) -> str | None:
    try:
        return process.environ().get(MARK)
    except psutil.Error:
        return None


def _command(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return str(process)
