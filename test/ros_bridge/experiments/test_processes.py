"""Processes of an experiment end, or it is said that they did not."""

from __future__ import annotations

import logging
import os
import sys
import tracemalloc
from pathlib import Path

import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import WorkerLostError
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


def test_what_a_program_prints_is_quoted_within_bounds(tmp_path: Path) -> None:
    """300 MB in one line went whole into the error, the terminal and both reports."""
    script = "head -c 30000000 /dev/zero | tr '\\0' a; printf '\\n\\033[2Jlast'; exit 3"
    tracemalloc.start()
    try:
        with ManagedProcess(
            "it", ["sh", "-c", script], tmp_path / "log", os.environ, logs_output=True
        ) as it:
            wait_until(lambda: it.exit_code is not None)
            with pytest.raises(WorkerLostError) as told:
                it.check()
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (tmp_path / "log").stat().st_size > 30_000_000
    first, long, last = str(told.value).split("\n")
    assert first == "it ended with exit code 3"
    assert long == f"  | {'a' * 297}..."
    assert last == "  | \\x1b[2Jlast"
    assert most_bytes < 20_000_000


def test_a_program_that_prints_no_line_is_waited_for_within_bounds(tmp_path: Path) -> None:
    script = "head -c 30000000 /dev/zero | tr '\\0' a; printf '\\nready: yes\\n'; exec sleep 1000"
    tracemalloc.start()
    try:
        with ManagedProcess("it", ["sh", "-c", script], tmp_path / "log", os.environ) as it:
            assert it.wait_for_line("ready:", PATIENCE_S) == "yes"
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most_bytes < 20_000_000
