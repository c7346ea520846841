"""A bag whose writer is interrupted between any two lines is finished and whole."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

TRIALS = 60
PROGRAM = f"""
import sys
from pathlib import Path
from oaisys_ros_bridge.bags.mcap_format.finished_bag import open_finished
from oaisys_ros_bridge.bags.mcap_format.mcap_writer import McapWriter

for trial in range({TRIALS}):
    path = Path(sys.argv[1], f"{{trial}}.mcap")
    bag = McapWriter(path, profile="ros2")
    channel = bag.add_channel("/a", bag.add_schema("std_msgs/msg/Empty", "ros2msg", b""), {{}})
    written = 0
    try:
        print("writing", flush=True)
        while True:
            bag.add_message(channel, written, b"message", written)
            written += 1
    except KeyboardInterrupt:
        bag.finish()
    with open_finished(path) as (_, summary):
        counted = summary.statistics.message_count
    print(written, counted, flush=True)
"""


def test_a_bag_is_whole_wherever_its_writer_is_interrupted(tmp_path: Path) -> None:
    """Its summary had a wrong checksum, or counted a message less."""
    rng = random.Random(0)
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        try:
            for trial in range(TRIALS):
                assert program.stdout.readline() == "writing\n", trial
                time.sleep(rng.uniform(0.001, 0.004))
                program.send_signal(signal.SIGINT)
                written, counted = map(int, program.stdout.readline().split())
                assert counted - written in (0, 1), trial
        finally:
            program.kill()
