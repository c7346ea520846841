"""Configures Fast DDS for large images in shared memory."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

from oaisys_core.system.private_files import hide_file
from oaisys_ros_bridge.namespaces import current_domain
from oaisys_ros_bridge.shared_memory import SHARED_MEMORY, require_safe_ports

NEEDED_BYTES = 512 * 2**20
"""Free shared memory for the segments of ``fastdds.xml`` in eight participants."""

SEGMENTS = ("fastrtps_", "fastdds_", "fast_datasharing")
"""How the names of Fast DDS's segments begin."""

PROFILES = Path(__file__).with_name("fastdds.xml")

FAST_DDS = "fastrtps"
"""Part of the names of the middlewares with Fast DDS; one of them is ROS's default."""

SKIP_OF_CURRENT_FOLDER = "SKIP_DEFAULT_XML_FILE", "SKIP_DEFAULT_XML"
"""Variables by which Fast DDS 2 and 3 do not read ``DEFAULT_FASTRTPS_PROFILES.xml`` in the current
folder: it may be another user's, and may name a file that is written to."""

OVERRIDES = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
)
"""Environment variables by which a user configures Fast DDS."""


def prepare_transport() -> None:
    """Use ``fastdds.xml`` in this process and its children; call it before `rclpy.init`.

    Leaves it as it is if the user has configured Fast DDS, or if there is too little shared memory,
    such as a container's 64 MB.

    Raises:
        OaisysError: Another user has planted something in shared memory, see `require_safe_ports`.
    """
    for name in SKIP_OF_CURRENT_FOLDER:
        os.environ.setdefault(name, "1")
    if FAST_DDS in os.environ.get("RMW_IMPLEMENTATION", FAST_DDS):
        require_safe_ports(current_domain())
    if any(name in os.environ for name in OVERRIDES) or not SHARED_MEMORY.is_dir():
        return
    if shutil.disk_usage(SHARED_MEMORY).free >= NEEDED_BYTES:
        os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(PROFILES)


def hide_shared_memory() -> None:
    """Let no other user read this process's segments of Fast DDS; call it when the node is made.

    Fast DDS makes them readable for everybody, whatever the umask is.
    """
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        path = Path(line.split(maxsplit=5)[-1])
        if path.parent == SHARED_MEMORY and path.name.startswith(SEGMENTS):
            with suppress(OSError):  # removed since, a link in its place, or another user's
                hide_file(path)
