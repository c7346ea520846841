"""A program is told to end by a signal, whatever its main thread is doing."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time

TRIALS = 300
PROGRAM = f"""
import sys
from oaisys_core import end_request

end_request._LOOK_UP_MS = 0
for _ in range({TRIALS}):
    end = end_request.EndRequest()
    with end.requested_by_signals():
        print("waiting", flush=True)
        end.wait()
        assert end.made and not end.repeated
        print("asked", flush=True)
        sys.stdin.readline()
"""


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
                program.send_signal(signal.SIGINT)
                assert program.stdout.readline() == "asked\n", trial
                program.stdin.write("\n")
                program.stdin.flush()
            assert program.wait(60.0) == 0
        finally:
            program.kill()
