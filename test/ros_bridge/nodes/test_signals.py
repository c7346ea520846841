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
