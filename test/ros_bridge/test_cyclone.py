"""Cyclone DDS hears what is published here, with the one setting that docs/ros.md names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY
from ros_peer import Stage
from sensor_msgs.msg import Image
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down
from oaisys_ros_bridge.qos import SENSOR_QOS

pytest.importorskip("cyclonedds", exc_type=ModuleNotFoundError)
pytestmark = pytest.mark.ros

READER = Path(__file__).with_name("cyclone_reader.py")
PAGE = REPOSITORY / "docs" / "ros.md"
DEPTH = "camera/depth/image_raw"


def documented_setting() -> str:
    found = re.search(r"CYCLONEDDS_URI='([^']+)'", PAGE.read_text(encoding="utf-8"))
    assert found is not None
    return found[1]


@pytest.mark.long
def test_a_reader_of_cyclone_dds_gets_an_image_bit_for_bit(stage: Stage) -> None:
    user = stage.user
    user.listen(Image, DEPTH, SENSOR_QOS)
    stage.start_bridge(stage.start_world(FLAT_WORLD).address)
    user.wait_until_ready()
    # Nothing of ours: neither ROS's libraries nor a transport chosen for Fast DDS.
    own = {k: v for k, v in os.environ.items() if not k.startswith(("RMW", "FAST", "LD_"))}
    with subprocess.Popen(
        [sys.executable, str(READER), f"rt/{DEPTH}"],
        stdout=subprocess.PIPE,
        text=True,
        env={**own, "CYCLONEDDS_URI": documented_setting()},
    ) as reader:
        # Either may know the other while it is still unknown to it.
        user.wait_until_matched([f"/{DEPTH}"], subscribers=2)
        assert reader.stdout is not None
        assert reader.stdout.readline() == "matched\n"
        answer = user.set_pose(pose_looking_down(0.5, 0.0, 5.0))
        assert answer.success, answer.message
        told = reader.communicate(timeout=120)[0]

    image = user.wait_until(lambda: user.received[DEPTH])[0]
    assert told == f"{image.width}x{image.height} 32FC1 {sum(image.data)}\n"
