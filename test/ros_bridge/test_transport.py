"""Shared memory of nodes, which other users of a machine must not read."""

from __future__ import annotations

from pathlib import Path

import pytest

from oaisys_ros_bridge.nodes.background_node import BackgroundNode
from oaisys_ros_bridge.shared_memory import SHARED_MEMORY
from oaisys_ros_bridge.transport import SEGMENTS

pytestmark = pytest.mark.ros


@pytest.mark.usefixtures("ros_domain_id")
def test_other_users_cannot_read_the_shared_memory_of_a_node() -> None:
    node = BackgroundNode("hidden")
    try:
        lines = Path("/proc/self/maps").read_text().splitlines()
        paths = {Path(line.split(maxsplit=5)[-1]) for line in lines if str(SHARED_MEMORY) in line}
        # Those of other processes that have ended are still mapped, as "... (deleted)".
        segments = [path for path in paths if path.name.startswith(SEGMENTS) and path.exists()]
        assert segments
        assert {path.stat().st_mode & 0o777 for path in segments} == {0o600}
    finally:
        node.close()
