"""Processes of an experiment end, or it is said that they did not."""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path

import pytest

from oaisys_core.system import processes
from oaisys_core.system.processes import ManagedProcess

NODE_WITHOUT_AN_END = """
import threading
from rclpy.node import Node
from oaisys_ros_bridge.nodes.node_process import run_node

class NodeWithoutAnEnd(Node):
    def close(self):
        print("closing", flush=True)
        threading.Event().wait()

def node_without_an_end():
    print("ready", flush=True)
    return NodeWithoutAnEnd("node_without_an_end")

run_node(node_without_an_end)
"""


@pytest.mark.ros
def test_a_node_that_does_not_end_is_killed_and_its_log_says_where_it_was(
    tmp_path: Path,
    ros_domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(processes, "END_TIMEOUT_S", 0.2)
    log = tmp_path / "node.log"
    command = [sys.executable, "-c", NODE_WITHOUT_AN_END]
    with caplog.at_level(logging.WARNING), ManagedProcess("it", command, log, os.environ) as it:
        it.wait_for_line("ready", 60.0)
        it.interrupt()
        it.wait_for_line("closing", 60.0)
    assert caplog.messages == [f"it has not ended within 0.2 s and is killed; its log: {log}"]
    assert " in close\n" in log.read_text()
