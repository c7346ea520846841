"""A node is told to end by a signal, whatever its main thread is doing."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time

import pytest

TRIALS = 300
PROGRAM = f"""
import sys, threading
from oaisys_ros_bridge.nodes.node_process import stop_on_signals

for _ in range({TRIALS}):
    stop = threading.Event()
    stop_on_signals(stop)
    print("waiting", flush=True)
    while not stop.wait(0.00001):
        pass
    print("stopped", flush=True)
    sys.stdin.readline()
"""


@pytest.mark.ros
def test_a_signal_at_any_moment_ends_the_wait() -> None:
    rng = random.Random(0)
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        try:
            for trial in range(TRIALS):
                assert program.stdout.readline() == "waiting\n"
                time.sleep(rng.uniform(0.0, 0.001))
                program.send_signal(rng.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP)))
                assert program.stdout.readline() == "stopped\n", trial
                program.stdin.write("\n")
                program.stdin.flush()
            assert program.wait(60.0) == 0
        finally:
            program.kill()


BUSY_PROGRAM = """
import sys, threading
import oaisys_core  # before Open3D
import open3d as o3d
from rclpy.node import Node
from oaisys_ros_bridge import services
from oaisys_ros_bridge.nodes.node_process import run_node

services.END_S = 0.1

class Busy(Node):
    def __init__(self):
        super().__init__("busy")
        self._requests = services.RequestQueue(self)
        self._requests.submit(self._work)

    def _work(self):
        print("working", flush=True)
        while True:
            o3d.core.Tensor.ones((100, 1000)).sum()

    def close(self):
        services.close_queues([self._requests])

sys.exit(run_node(Busy, ["busy"]))
"""


@pytest.mark.ros
@pytest.mark.parametrize("times", [1, 2])
def test_a_signal_ends_a_node_whose_request_takes_longer(times: int, ros_domain_id: int) -> None:
    """The mapper in ``~/evaluate`` ended with 1, and Open3D printed all memory that it had."""
    with subprocess.Popen(
        [sys.executable, "-c", BUSY_PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as program:
        assert program.stdout is not None
        try:
            assert program.stdout.readline() == "working\n"
            for _ in range(times):
                program.send_signal(signal.SIGTERM)
            assert program.stdout.read() == ""
            assert program.wait(60.0) == 0
        finally:
            program.kill()
