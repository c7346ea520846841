"""What a sweep or drive is told of readers that end while it goes on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from std_msgs.msg import Header

from oaisys_msgs.msg import Loss, SampleReceipt
from oaisys_ros_bridge.bridge.back_pressure import BackPressure
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.nodes.background_node import BackgroundNode

pytestmark = pytest.mark.ros

RECORDER, DEPTH = "/oaisys_recorder", "/camera/depth/image_raw"
SETTINGS = {"readers.when_behind": "wait", "readers.timeout_s": 1.0}


def receipt(sample: int, *, ended: bool = False, incomplete: int = 0) -> SampleReceipt:
    return SampleReceipt(
        header=Header(stamp=stamp_from_nanoseconds(sample)),
        node=RECORDER,
        instance=1,
        batch_id=min(sample, 1),
        sample_id=sample,
        samples=sample,
        samples_incomplete=incomplete,
        lost=[Loss(what=DEPTH, count=incomplete)] if incomplete else [],
        ended=ended,
    )


def publish(readers: BackPressure, sample: int) -> None:
    made: Any = SimpleNamespace(batch_id=1, sample_id=sample)
    readers.begin()
    readers.expect(made, stamp_from_nanoseconds(sample))


@pytest.mark.parametrize(
    ("last", "told"),
    [
        (receipt(2, ended=True), []),
        (receipt(1, ended=True), [f"{RECORDER} had ended before the last sample"]),
        (
            receipt(2, ended=True, incomplete=1),
            [f"{RECORDER}: 1 of 2 samples are incomplete; lost: {DEPTH} 1"],
        ),
    ],
)
def test_a_reader_that_ends_before_the_last_sample_is_told(
    last: SampleReceipt, told: list[str], ros_domain_id: int
) -> None:
    """A recorder whose disk was full in the middle of a sweep was forgotten without a word."""
    with BackgroundNode("bridge") as bridge:
        readers = BackPressure(bridge.node, lambda: SETTINGS)
        readers._on_receipt(receipt(0))
        before = readers.states()
        publish(readers, 1)
        readers._on_receipt(receipt(1))
        publish(readers, 2)
        if last.sample_id == 2:
            readers._on_receipt(receipt(2))
        readers._on_receipt(last)
        assert readers.shortfalls(before) == told
        later = readers.states()
        publish(readers, 3)
        assert readers.shortfalls(later) == []
