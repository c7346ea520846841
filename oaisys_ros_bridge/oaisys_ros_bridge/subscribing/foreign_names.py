"""Names in the messages of others that a node keeps or publishes again: bounded as they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from oaisys_core.errors import InvalidInputError
from oaisys_msgs.msg import Loss, SemanticLabels

LONGEST_ROS_NAME = 255
"""Characters of a full name of a node or topic; the middleware allows no longer ones."""

MAX_LOSSES = 100
"""Names of losses that are kept of one reader; the others are counted together."""

MAX_TOPICS = 5000
"""Topics on which samples have messages."""

OTHERS = "others"


def check_name(field: str, name: str) -> None:
    """Raise `InvalidInputError` where a name is longer than one of ROS's can be."""
    if len(name) > LONGEST_ROS_NAME:
        raise InvalidInputError(field, name, f"at most {LONGEST_ROS_NAME} characters")


def check_topics(topics: Collection[str]) -> None:
    """Raise `InvalidInputError` where topics are more, or have longer names, than in any rig."""
    if len(topics) > MAX_TOPICS:
        raise InvalidInputError("topics", f"{len(topics)} topics", f"at most {MAX_TOPICS}")
    for topic in topics:
        check_name("topics", topic)


def counts_of_losses(losses: Sequence[Loss]) -> dict[str, int]:
    """Return counts by name; inverse: `losses_msg`, unless there are many or long names."""
    counts: Counter[str] = Counter()
    for index, loss in enumerate(losses):
        what = loss.what[:LONGEST_ROS_NAME] if index < MAX_LOSSES else OTHERS
        counts[what] += loss.count
    return dict(counts)


def class_names_of(message: SemanticLabels) -> dict[int, str]:
    """Return the names of classes by their ids in a legend, the first characters of long ones."""
    return {label.id: label.name[:LONGEST_ROS_NAME] for label in message.labels}
