"""What a soak counts: what each process holds, and the messages of each sample in the bag."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from oaisys_core.system.ending.owner import command_with_owner
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bags.info import losses_of
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_class
from oaisys_ros_bridge.bags.mcap_format.serialized_stamps import stamp_reader
from oaisys_ros_bridge.bags.reading import BagReader

SAMPLE_INFO = "/sample_info"

NAMES = {
    "oaisys_grpc.worker": "worker",
    "oaisys_grpc": "server",
    "oaisys_ros_bridge.nodes.bridge": "bridge",
    "oaisys_ros_bridge.nodes.mapper": "mapper",
    "oaisys_ros_bridge.nodes.recorder": "recorder",
}
"""Names of processes in the table, by the module that they run."""

_SHARED = re.compile(r"(\S+ \d+) +(?:/dev/shm/|/memfd:)")
"""Device and inode of shared memory in a line of ``/proc/PID/maps``."""


@dataclass(frozen=True)
class Gauge:
    """Resources of a process at one time.

    Attributes:
        pss_mb: Proportional set size: shared memory is divided among its users.
        private_mb: Memory that is not shared.
        descriptors: Open file descriptors.
        threads: Running threads.
        shared_segments: Mapped files in shared memory.
    """

    pss_mb: float
    private_mb: float
    descriptors: int
    threads: int
    shared_segments: int


def read_gauges(root: psutil.Process) -> Mapping[str, Gauge]:
    """Return the gauges of the known processes below ``root``, by name."""
    gauges = {}
    for process in root.children(recursive=True):
        with contextlib.suppress(psutil.Error, OSError):
            if name := _name_of(process.cmdline()):
                gauges[name] = _gauge_of(process)
    return gauges


def _name_of(command: list[str]) -> str:
    """Return a process's name in the table; empty: it is not a known process."""
    return next((name for module, name in NAMES.items() if module in command), "")


def _gauge_of(process: psutil.Process) -> Gauge:
    memory = process.memory_full_info()
    maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
    return Gauge(
        pss_mb=memory.pss / 1e6,
        private_mb=memory.uss / 1e6,
        descriptors=process.num_fds(),
        threads=process.num_threads(),
        shared_segments=len(set(_SHARED.findall(maps))),
    )


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Run busy loops during the block, to load the machine's cores."""
    command = command_with_owner([sys.executable, "-c", "while True: pass"])
    loops = [subprocess.Popen(command) for _ in range(count)]
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
            announced[stamp_ns] = message.deserialize(SampleInfo)
    return stamps, announced
