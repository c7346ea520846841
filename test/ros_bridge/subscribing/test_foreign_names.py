"""Names in the messages of others, as far as a node keeps them."""

from __future__ import annotations

import pytest
from ros_peer import User

from oaisys_core.errors import InvalidInputError
from oaisys_msgs.msg import Loss, SampleInfo, SemanticLabel, SemanticLabels
from oaisys_ros_bridge.bags.announced_samples import AnnouncedSamples
from oaisys_ros_bridge.bags.wire_names import WireNames
from oaisys_ros_bridge.subscribing.foreign_names import (
    LONGEST_ROS_NAME,
    MAX_LOSSES,
    MAX_TOPICS,
    OTHERS,
    check_topics,
    class_names_of,
    counts_of_losses,
)
from oaisys_ros_bridge.subscribing.sample_watch import losses_msg

LONG = "x" * 1000


def test_counts_of_losses_keep_their_sum() -> None:
    few = {f"/topic{number}": number for number in range(MAX_LOSSES)}
    assert counts_of_losses(losses_msg(few)) == few
    many = [Loss(what=f"{number}{LONG}", count=number) for number in range(3 * MAX_LOSSES)]
    counts = counts_of_losses(many)
    assert len(counts) == MAX_LOSSES + 1
    assert max(map(len, counts)) == LONGEST_ROS_NAME
    assert counts[OTHERS] == sum(range(MAX_LOSSES, 3 * MAX_LOSSES))


def test_names_of_classes_are_bounded() -> None:
    labels = [SemanticLabel(id=1, name="rock"), SemanticLabel(id=2, name=LONG)]
    expected = {1: "rock", 2: LONG[:LONGEST_ROS_NAME]}
    assert class_names_of(SemanticLabels(labels=labels)) == expected


@pytest.mark.parametrize("topics", [[LONG], [str(number) for number in range(MAX_TOPICS + 1)]])
def test_topics_of_no_rig_are_refused(topics: list[str]) -> None:
    with pytest.raises(InvalidInputError, match=r"topics: received .*, expected at most"):
        check_topics(topics)


@pytest.fixture
def samples(user: User) -> AnnouncedSamples:
    """The samples of a recorder of all topics that was there before the bridge."""
    samples = AnnouncedSamples(WireNames(user.node), lambda _: True)
    samples.follow("/oaisys_bridge/sample_info")
    samples.begin(0, ())
    return samples


@pytest.mark.ros
def test_a_recorder_keeps_no_topics_of_no_rig(samples: AnnouncedSamples) -> None:
    """They were in its receipts, its last line and the bag."""
    (watch,) = samples._watches.values()
    for index, topics in enumerate(([LONG], [f"/t{n}" for n in range(MAX_TOPICS)], ["/other"])):
        info = SampleInfo(sample_id=index + 1, sequence=index + 1, topics=topics)
        info.header.stamp.sec = index + 1
        samples._on_sample_info(watch, info, {"source_timestamp": 10**18})
    samples.give_up_all()
    assert watch.ledger.state.lost == {f"/t{n}": 1 for n in range(MAX_TOPICS)}
