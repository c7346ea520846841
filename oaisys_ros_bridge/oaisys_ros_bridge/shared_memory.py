"""Says where shared memory is full: what ROS loads ends the process there, without a word."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from oaisys_core.errors import ShortageError

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - Linux's name for it
LOADING_BYTES = 16 * 2**10
"""What LTTng, which rclpy loads, needs there at least: two files of a page, and some room."""


def require_shared_memory(folder: Path = SHARED_MEMORY) -> None:
    """Do nothing where rclpy can be loaded; call it before that.

    LTTng reads files that it has made there; where they get no memory, that is a SIGBUS. Where they
    have it, because this user has run a node before, rclpy and Fast DDS work in a full folder, too.

    Raises:
        ShortageError: The folder is full.
    """
    if not folder.is_dir() or shutil.disk_usage(folder).free >= LOADING_BYTES:
        return
    files = folder.glob(f"lttng-ust-wait-*-{os.getuid()}")
    if not any(file.stat().st_blocks for file in files):
        raise ShortageError(f"{folder} is full: ROS cannot be loaded without shared memory")
