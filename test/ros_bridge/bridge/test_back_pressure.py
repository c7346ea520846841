"""What a sweep or drive is told of readers that end while it goes on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from std_msgs.msg import Header

from oaisys_msgs.msg import Loss, SampleReceipt
from oaisys_ros_bridge.bridge.back_pressure import MAX_READERS, BackPressure
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


def size_of(values: dict[str, object]) -> int:
    return sum(len(f"{key}{value}") for key, value in values.items())


def test_receipts_that_nobody_means_well_swell_nothing(ros_domain_id: int) -> None:
    """One of 20 MB was in each diagnostic message four times, and held up all requests."""
    with BackgroundNode("bridge") as bridge:
        readers = BackPressure(bridge.node, lambda: SETTINGS)
        giant = "x" * 1_000_000
        readers._on_receipt(SampleReceipt(node=giant))
        wrong, values = readers.diagnostics()
        assert values == {"refused receipts": 1}
        assert wrong == ["1 receipts do not count: of too many readers, or of too long names"]
        assert not readers.states()

        lost = [Loss(what=f"{number}{giant}", count=1) for number in range(10)]
        lost += [Loss(what=str(number), count=2) for number in range(1000)]
        readers._on_receipt(SampleReceipt(node=RECORDER, samples_incomplete=1, lost=lost))
        (state,) = readers.states().values()
        assert sum(state.lost.values()) == 10 + 2 * 1000
        assert state.lost["others"] == 2 * (1010 - 100)
        assert size_of(readers.diagnostics()[1]) < 10_000


def test_readers_are_bounded_and_those_that_are_there_stay(ros_domain_id: int) -> None:
    with BackgroundNode("bridge") as bridge:
        readers = BackPressure(bridge.node, lambda: SETTINGS)
        readers._on_receipt(receipt(1))
        readers._readers[RECORDER, 1].is_known = True
        for number in range(2 * MAX_READERS):
            readers._on_receipt(SampleReceipt(node=f"/node{number}"))
        names = {node for node, _ in readers.states()}
        assert names == {RECORDER} | {
            f"/node{number}" for number in range(MAX_READERS + 1, 2 * MAX_READERS)
        }
        assert readers.diagnostics()[1]["refused receipts"] == MAX_READERS + 1
