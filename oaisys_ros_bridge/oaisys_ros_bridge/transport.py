"""Makes room for images in the middleware's shared memory."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108 - Linux's name for it
NEEDED_BYTES = 512 * 2**20
"""Free shared memory for the segments of ``fastdds.xml`` in eight participants."""

PROFILES = Path(__file__).with_name("fastdds.xml")

OVERRIDES = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
)
"""Settings of the user's that win over ours."""


def prepare_transport() -> None:
    """Choose ``fastdds.xml`` for this process and its children; to be called before rclpy starts.

    Does nothing where the user has chosen transports, or where shared memory is as small as a
    container's 64 MB.
    """
    if any(name in os.environ for name in OVERRIDES) or not SHARED_MEMORY.is_dir():
        return
    if shutil.disk_usage(SHARED_MEMORY).free >= NEEDED_BYTES:
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILES)
