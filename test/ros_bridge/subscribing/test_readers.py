"""Recorders that are there before the bridge, come later, share a name, or are killed."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import pytest
import yaml
from ros_peer import SAMPLE_TYPES, NodeProcess, Stage
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.msg import SampleReceipt
from oaisys_ros_bridge.bags.losses import BagLosses
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS

pytestmark = pytest.mark.ros

INFO = "/oaisys_bridge/sample_info"
MISSED, SEEN = 3, 10


class Recorders:
    """Recorders of everything, each with a bag and a log."""

    def __init__(self, stage: Stage, folder: Path) -> None:
        self._user, self._folder = stage.user, folder
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start(self, name: str) -> NodeProcess:
        bag = self._folder / name
        recorder = NodeProcess("recorder", bag.with_suffix(".log"), "--out", str(bag), "--all")
        self._stack.callback(recorder.end)
        self._user.wait_until(lambda: "recording:" in recorder.log.read_text())
        return recorder

    def wait_until_matched(self, recorders: int) -> None:
        """Wait until the bridge knows all subscriptions of the recorders."""
        self._user.wait_until_matched(SAMPLE_TYPES.keys() - {INFO}, subscribers=recorders)
        self._user.wait_until_matched([INFO], subscribers=2 * recorders)

    def wait_until_taken(self, *samples: int) -> None:
        """Wait until each recorder's newest receipt is of so many samples, in any order."""
        if "oaisys_bridge/receipts" not in self._user.received:
            self._user.listen(SampleReceipt, "oaisys_bridge/receipts", LATCHED_HISTORY_QOS)
        receipts = self._user.received["oaisys_bridge/receipts"]
        self._user.wait_until(
            lambda: sorted({r.instance: r.samples for r in receipts}.values()) == sorted(samples)
        )

    def losses(self, name: str) -> BagLosses:
        description = yaml.safe_load((self._folder / name / "metadata.yaml").read_text())
        return BagLosses.read(description["rosbag2_bagfile_information"]["custom_data"])


@pytest.fixture
def recorders(stage: Stage, tmp_path: Path) -> Iterator[Recorders]:
    with Recorders(stage, tmp_path) as recorders:
        yield recorders


def take(stage: Stage, views: int) -> None:
    for index in range(views):
        answer = stage.user.set_pose(pose_looking_down(0.1 * index, 0.0, 5.0))
        assert answer.success, answer.message


def start_bridge(stage: Stage, *parameters: str) -> NodeProcess:
    address = stage.start_world(FLAT_WORLD).address
    options = [o for p in (f"address:={address}", *parameters) for o in ("-p", p)]
    bridge = stage.start_node("bridge", "--ros-args", *options)
    stage.user.wait_until_ready()
    return bridge


@pytest.mark.long
def test_an_early_recorder_says_what_it_missed_and_a_killed_one_is_dropped_beside_others(
    stage: Stage, recorders: Recorders
) -> None:
    """The first said "2 samples, none of them incomplete"; the killed one stayed for ever."""
    first = recorders.start("first")
    first.process.send_signal(signal.SIGSTOP)  # while it is stopped, it is not discovered
    try:
        bridge = start_bridge(stage, "readers.timeout_s:=1.0")
        take(stage, MISSED)
    finally:
        first.process.send_signal(signal.SIGCONT)
    killed, later = recorders.start("killed"), recorders.start("later")
    recorders.wait_until_matched(3)
    take(stage, 1)
    recorders.wait_until_taken(MISSED + 1, 1, 1)
    killed.end(signal.SIGKILL)
    take(stage, 1)
    recorders.wait_until_taken(MISSED + 2, 1, 2)
    stage.user.wait_until(lambda: "has gone without a word" in bridge.log.read_text())
    take(stage, SEEN - 2)
    recorders.wait_until_taken(MISSED + SEEN, 1, SEEN)

    log = bridge.log.read_text()
    gone = f"has gone without a word before it had taken sample {MISSED + 2} of batch"
    assert log.count(gone) == 1
    assert "has not taken" not in log
    assert (first.end(), later.end()) == (0, 0)
    losses = recorders.losses("first")
    assert (losses.announced, losses.incomplete) == (MISSED + SEEN, MISSED)
    assert losses.lost[INFO] == losses.lost["/camera/depth/image_raw"] == MISSED
    said = f"{MISSED} of {MISSED + SEEN} samples are incomplete"
    assert said in first.log.read_text()
    assert recorders.losses("later") == BagLosses(announced=SEEN)
    assert f"{SEEN} samples, none of them incomplete" in later.log.read_text()


@pytest.mark.soak
def test_two_recorders_of_one_name_are_two_readers(stage: Stage, recorders: Recorders) -> None:
    """The faster one's receipts cleared what the stopped one owed: nobody was told."""
    bridge = start_bridge(stage, "readers.timeout_s:=1.0")
    first, second = recorders.start("first"), recorders.start("second")
    recorders.wait_until_matched(2)
    take(stage, 1)
    recorders.wait_until_taken(1, 1)
    second.process.send_signal(signal.SIGSTOP)
    try:
        take(stage, 8)
        log = bridge.log.read_text()
        assert log.count("it is not waited for any more") == 1
    finally:
        second.process.send_signal(signal.SIGCONT)
    stage.user.wait_until(lambda: "takes samples again" in bridge.log.read_text())
    assert first.end() == 0
    assert second.end() == 0
    assert recorders.losses("first") == BagLosses(announced=9)
    assert recorders.losses("second").announced == 9
