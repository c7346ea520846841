"""Shared memory of nodes, which other users of a machine must not read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from oaisys_ros_bridge.nodes.background_node import BackgroundNode
from oaisys_ros_bridge.shared_memory import SHARED_MEMORY
from oaisys_ros_bridge.transport import SEGMENTS

pytestmark = pytest.mark.ros

PROFILES_WITH_LOG = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <log>
    <use_default>FALSE</use_default>
    <consumer>
      <class>FileConsumer</class>
      <property><name>filename</name><value>{}</value></property>
      <property><name>append</name><value>FALSE</value></property>
    </consumer>
  </log>
</dds>
"""


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


@pytest.mark.usefixtures("ros_domain_id")
def test_profiles_in_the_current_folder_are_not_read(
    tmp_path: Path,
) -> None:
    """Such a file names a log that Fast DDS truncates."""
    log = tmp_path / "log"
    log.write_text("kept")
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(PROFILES_WITH_LOG.format(log))
    code = (
        "from oaisys_ros_bridge.nodes.background_node import BackgroundNode\n"
        "BackgroundNode('reads').close()"
    )
    subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, check=True)
    assert log.read_text() == "kept"
