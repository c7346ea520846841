"""The bridge and a server that encrypts, and that wants to know who comes."""

from __future__ import annotations

from pathlib import Path

import pytest
from certificates import Authority
from diagnostic_msgs.msg import DiagnosticArray
from ros_peer import NodeProcess, Stage
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down
from oaisys_ros_bridge.qos import SENSOR_QOS

pytestmark = pytest.mark.ros


def start_bridge(stage: Stage, address: str, **tls: Path) -> NodeProcess:
    parameters = {"address": address, **{f"tls_{name}": path for name, path in tls.items()}}
    pairs = (pair for p, v in parameters.items() for pair in ("-p", f"{p}:={v}"))
    return stage.start_node("bridge", "--ros-args", *pairs)


@pytest.mark.long
def test_a_bridge_gets_in_with_its_certificate_only(stage: Stage, tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    cert, key = authority.pair("server")
    own_cert, own_key = authority.pair("bridge")
    strangers_cert, strangers_key = Authority(tmp_path, "strangers").pair("stranger")
    server = stage.start_world(
        FLAT_WORLD,
        *("--tls-cert", str(cert), "--tls-key", str(key), "--tls-client-ca", str(authority.ca)),
    )
    user = stage.user
    user.listen(DiagnosticArray, "/diagnostics", SENSOR_QOS)
    diagnostics = user.received["/diagnostics"]

    stranger = start_bridge(
        stage, server.address, ca=authority.ca, cert=strangers_cert, key=strangers_key
    )
    user.wait_until(lambda: diagnostics and diagnostics[-1].status[0].level == b"\x02")
    assert not user.set_pose(pose_looking_down(0, 0, 5)).success
    assert stranger.end() == 0

    bridge = start_bridge(stage, server.address, ca=authority.ca, cert=own_cert, key=own_key)
    user.wait_until_ready()
    answer = user.set_pose(pose_looking_down(0, 0, 5))
    assert answer.success, answer.message
    assert (answer.batch_id, answer.sample_id) == (1, 1)
    assert bridge.end() == 0
    assert "Traceback" not in stranger.log.read_text() + bridge.log.read_text()
