"""Configures Fast DDS for large images in shared memory."""

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
"""Environment variables by which a user configures Fast DDS."""


def prepare_transport() -> None:
    """Use ``fastdds.xml`` in this process and its children; call it before `rclpy.init`.

    Does nothing if the user has configured Fast DDS, or if there is too little shared memory, such
    as a container's 64 MB.
    """
    if any(name in os.environ for name in OVERRIDES) or not SHARED_MEMORY.is_dir():
        return
    if shutil.disk_usage(SHARED_MEMORY).free >= NEEDED_BYTES:
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILES)
