"""A pytest that is told to end takes its nodes with it: their ROS domain is free then."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from repository import REPOSITORY, TESTS
from waiting import START_PATIENCE_S, wait_until

WITH_A_NODE = """
import signal
from pathlib import Path
from oaisys_msgs.msg import MapStatus
from oaisys_ros_bridge.qos import LATCHED_QOS
from ros_peer import Stage

def test_that_fails():
    assert 1 + 1 == 3

def test_that_waits(ros_domain_id, no_process_left, tmp_path):
    with Stage(tmp_path) as stage:
        stage.user.listen(MapStatus, "oaisys_mapper/metrics", LATCHED_QOS)
        node = stage.start_node("mapper")
        # While it is imported it may ignore signals, as the parents of a background job do.
        stage.user.wait_until(lambda: stage.user.received["oaisys_mapper/metrics"])
        Path({pid!r}).write_text(f"{{node.process.pid}}\\n")
        while True:
            signal.pause()
"""


@pytest.mark.ros
@pytest.mark.parametrize(
    "workers",
    [
        pytest.param([], id="alone"),
        pytest.param(["-n", "1"], id="xdist", marks=pytest.mark.long),
    ],
)
def test_a_terminated_pytest_ends_its_nodes(workers: list[str], tmp_path: Path) -> None:
    pid, log = tmp_path / "pid", tmp_path / "log"
    shutil.copy(TESTS / "conftest.py", tmp_path)
    (tmp_path / "test_node.py").write_text(WITH_A_NODE.format(pid=str(pid)))
    options = ["-c", str(REPOSITORY / "pyproject.toml"), "-p", "no:cacheprovider", *workers]
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    with log.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *options, str(tmp_path / "test_node.py")],
            stdout=output,
            stderr=subprocess.STDOUT,
            env=env,
        )
    try:
        wait_until(
            lambda: pid.exists() and pid.read_text().endswith("\n"),
            START_PATIENCE_S,
            process=process,
            explain=log.read_text,
        )
        process.send_signal(signal.SIGTERM)
        assert process.wait(START_PATIENCE_S) != 0
        said = log.read_text()
        assert not psutil.pid_exists(int(pid.read_text())), said
        assert "INTERNALERROR" not in said
        assert "test_that_fails - assert (1 + 1) == 3" in said
        assert " failed" in said.splitlines()[-1]
    finally:
        process.kill()
        process.wait()
