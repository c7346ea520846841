"""What a worker does to itself, so that its failure stays its own."""

from __future__ import annotations

import contextlib
import resource
from pathlib import Path

_FILES = 4096
_OUT_OF_MEMORY_SCORE = 500
"""Half of the machine's memory on top of its own, where the kernel chooses what to kill."""


def limit_worker() -> None:
    """Limit this process.

    No core files: Blender's are gigabytes. Few files, so that a leak of them ends the worker and
    not the machine. Where memory is short, the kernel kills the worker rather than its server.
    Memory itself is the server's to watch: Blender and Embree reserve far more addresses than they
    use, which a limit of the kernel's would count.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    files = _FILES if hard == resource.RLIM_INFINITY else min(_FILES, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    with contextlib.suppress(OSError):  # a container may forbid it
        Path("/proc/self/oom_score_adj").write_text(str(_OUT_OF_MEMORY_SCORE), encoding="ascii")
