"""Checks that a bag holds every message of every sample."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rclpy.serialization import deserialize_message

from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bags.info import losses_of
from oaisys_ros_bridge.bags.message_definition import message_class
from oaisys_ros_bridge.bags.reading import BagReader
from oaisys_ros_bridge.bags.serialized_stamps import stamp_reader

SAMPLE_INFO = "/sample_info"


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Run busy loops during the block, to load the machine's cores."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def missing_in_bag(bag: Path, samples: int) -> Sequence[str]:
    """Return a sentence for each topic of which a bag has not the messages of all samples.

    The messages are counted independently of the recorder, whose own count is compared with it.
    """
    stamps, announced = stamps_of(bag)
    faults = []
    if len(announced) != samples:
        faults.append(f"bag: {len(announced)} of {samples} samples on sample_info")
    topics = {topic for info in announced.values() for topic in info.topics}
    lacking = 0
    for topic in sorted(topics & stamps.keys()):
        wanted = {stamp_ns for stamp_ns, info in announced.items() if topic in info.topics}
        missing = len(wanted - stamps[topic])
        lacking += missing
        if missing or len(wanted) != samples:
            faults.append(f"bag: {len(wanted) - missing} of {samples} samples on {topic}")
    losses = losses_of(bag)
    counted = None if losses is None else sum(losses.lost.values())
    if counted != lacking:
        faults.append(f"bag: its recorder counted {counted} lost messages, not {lacking}")
    return faults


def stamps_of(bag: Path) -> tuple[dict[str, set[int]], dict[int, SampleInfo]]:
    """Return the stamps of each topic's messages, and the ``sample_info`` messages by stamp."""
    stamps: dict[str, set[int]] = {}
    announced: dict[int, SampleInfo] = {}
    reader = BagReader(bag)
    stamp_readers = {
        name: read_stamp
        for name, topic in reader.topics.items()
        if (read_stamp := stamp_reader(message_class(topic.type_name))) is not None
    }
    for message in reader.messages(stamp_readers.keys()):
        stamp_ns = stamp_readers[message.topic](message.data)
        stamps.setdefault(message.topic, set()).add(stamp_ns)
        if message.topic.endswith(SAMPLE_INFO):
            announced[stamp_ns] = deserialize_message(message.data, SampleInfo)
    return stamps, announced
