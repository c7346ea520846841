"""What the processes of a test leave behind: themselves, shared memory, ports, temporary files."""

from __future__ import annotations

import contextlib
import os
import re
import threading
from pathlib import Path
from typing import Any, Self

import psutil

MARK = "OAISYS_TEST_PROCESS"
"""Variable that marks the processes of a test."""

_LOOK_PERIOD_S = 0.3
_SHARED = re.compile(r"/dev/shm/(?:fastrtps_[0-9a-f]{16}|.*oaisys.*)")
"""Of the middleware only what belongs to one process: ports are shared by all of the machine."""


class LeakCheck:
    """Watches all processes with a mark; a context manager."""

    def __init__(self, mark: str) -> None:
        self._mark = mark
        self._shared: set[str] = set()
        self._ports: set[int] = set()
        self._files: set[str] = set()
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="leak-check", daemon=True)

    def __enter__(self) -> Self:
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._watcher.join()

    def left_behind(self) -> list[str]:
        """End every process that still runs, and return what should not be there."""
        _, running = psutil.wait_procs(marked_processes(self._mark), timeout=5.0)
        left = [f"process: {_command(process)}" for process in running]
        for process in running:
            process.kill()
        left += [f"shared memory: {file}" for file in self._shared if Path(file).exists()]
        left += [f"socket: {file}" for file in self._files if Path(file).exists()]
        listening = _listening(psutil.net_connections("tcp"))
        return left + [f"port: {port}" for port in sorted(self._ports & listening)]

    def _watch(self) -> None:
        while not self._ended.wait(_LOOK_PERIOD_S):
            for process in marked_processes(self._mark):
                with contextlib.suppress(psutil.Error, OSError):
                    self._note(process)

    def _note(self, process: psutil.Process) -> None:
        for line in Path(f"/proc/{process.pid}/maps").read_text().splitlines():
            if found := _SHARED.search(line.removesuffix(" (deleted)")):
                self._shared.add(found[0])
        connections: list[Any] = process.net_connections("all")
        self._ports |= _listening(connections)
        addresses = {c.laddr for c in connections if isinstance(c.laddr, str)}
        self._files |= {address for address in addresses if address.startswith("/")}


def marked_processes(mark: str) -> list[psutil.Process]:
    """Return the processes of the test with this mark, orphans included, but not this one."""
    return [p for p in psutil.process_iter() if _mark_of(p) == mark and p.pid != os.getpid()]


def _listening(connections: list[Any]) -> set[int]:
    return {c.laddr.port for c in connections if c.status == "LISTEN"}


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
