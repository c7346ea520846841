"""Takes from a process what it does not need to read one file: other files, network, memory, time.

Linux's Landlock does the first two, where the kernel has it (5.13, for the network 6.7). Elsewhere
the names of files are checked alone.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

_CREATE, _ADD_RULE, _RESTRICT = 444, 445, 446
_VERSION_FLAG = 1
_RULE_PATH_BENEATH = 1
_NO_NEW_PRIVILEGES = 38

_READ = 1 << 2 | 1 << 3
_CHANGE = 1 << 1 | sum(1 << bit for bit in range(4, 13))
_ALL_TCP = 1 << 0 | 1 << 1
_NETWORK_ABI = 4

_SYSTEM = ("/usr", "/lib", "/lib64", "/opt", "/proc/self", "/proc/sys", "/sys/devices", "/dev")


def limit_access(readable: Iterable[Path], writable: Path) -> bool:
    """Let this process read only the system's and Python's files and some folders.

    Threads that run already are not limited.

    Args:
        readable: The folders.
        writable: A folder in which it may also write.

    Returns:
        Whether the kernel can do that.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    abi = libc.syscall(_CREATE, None, 0, _VERSION_FLAG)
    if abi < 1:
        return False
    rules = struct.pack("QQ", _READ | _CHANGE, _ALL_TCP if abi >= _NETWORK_ABI else 0)
    size = len(rules) if abi >= _NETWORK_ABI else 8
    ruleset = libc.syscall(_CREATE, rules, size, 0)
    if ruleset < 0:
        return False
    try:
        own = [*_SYSTEM, sys.prefix, sys.base_prefix, *sys.path]
        own += os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        for folder in (*own, *map(str, readable)):
            _allow(libc, ruleset, folder, _READ)
        _allow(libc, ruleset, str(writable), _READ | _CHANGE)
        if libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0):
            return False
        return bool(libc.syscall(_RESTRICT, ruleset, 0) == 0)
    finally:
        os.close(ruleset)


def _allow(libc: ctypes.CDLL, ruleset: int, folder: str, access: int) -> None:
    try:
        place = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError:
        return  # what is not there need not be read
    try:
        libc.syscall(_ADD_RULE, ruleset, _RULE_PATH_BENEATH, struct.pack("=Qi", access, place), 0)
    finally:
        os.close(place)


def limit_resources(memory_bytes: int, time_s: int) -> None:
    """End this process once it takes more memory or time, also if its parent is gone."""
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(time_s)
