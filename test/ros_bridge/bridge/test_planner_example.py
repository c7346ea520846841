"""The planner of the README, as a user runs it: beside a bridge, before one, and without one."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time

import pytest
from repository import REPOSITORY
from ros_peer import Stage
from served_simulator import FLAT_WORLD
from waiting import PATIENCE_S

from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.qos import SMALL_MESSAGE_QOS

PLANNER = REPOSITORY / "examples" / "03_planner.py"
SAMPLES = "oaisys_bridge/sample_info"


def started(timeout_s: float) -> subprocess.Popen[str]:
    command = [sys.executable, str(PLANNER), "--timeout", str(timeout_s)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(planner: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Return exit code, output and errors of a planner that ends by itself."""
    try:
        output, errors = planner.communicate(timeout=PATIENCE_S)
    finally:
        planner.kill()
        planner.wait()
    return planner.returncode, output, errors


def told(output: str) -> list[tuple[int, int]]:
    return [(int(b), int(s)) for b, s in re.findall(r"batch (\d+) sample (\d+) stamp", output)]


def test_the_readme_quotes_the_planner() -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    quoted = re.findall(r"```python\n(def look_from.*?)```", readme, re.DOTALL)
    assert len(quoted) == 1
    assert quoted[0] in PLANNER.read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.ros
def test_the_planner_gets_its_views_whoever_is_started_first_and_says_that_its_bridge_hangs(
    stage: Stage,
) -> None:
    stage.user.listen(SampleInfo, SAMPLES, SMALL_MESSAGE_QOS)
    early = started(PATIENCE_S)
    stage.user.wait_until(lambda: "planner" in stage.user.node.get_node_names())
    server = stage.start_world(FLAT_WORLD)
    stage.start_bridge(server.address)
    for planner, first in ((early, 1), (None, 4)):
        code, output, errors = ended(planner or started(PATIENCE_S))
        assert (code, errors) == (0, "")
        assert told(output) == [(1, first), (1, first + 1), (1, first + 2)]
        stage.user.wait_until_ready()
    samples = stage.user.received[SAMPLES]
    stage.user.wait_until(lambda: samples and samples[-1].sample_id == 6)
    assert [s.rig_pose.position.x for s in samples[-3:]] == [-4, 0, 4]

    server.process.send_signal(signal.SIGSTOP)
    try:
        code, _, errors = ended(started(5.0))
    finally:
        server.process.send_signal(signal.SIGCONT)
    assert code == 1
    assert "the view from (-4.0, 0.0, 8.0)" in errors
    assert "after 5 s" in errors


@pytest.mark.ros
def test_a_planner_without_a_bridge_says_so(ros_domain_id: int) -> None:
    began_s = time.monotonic()
    code, output, errors = ended(started(2.0))
    assert (code, output) == (1, "")
    assert "no bridge was ready after 2 s" in errors
    assert "Traceback" not in errors
    assert time.monotonic() - began_s < 30  # start-up on a loaded machine included
