"""The command ``ros2 bag record`` for the topics that this package's recorder would record."""

from __future__ import annotations

import re
from collections.abc import Collection

from oaisys_ros_bridge.bags.topic_selection import RECEIPT_TYPE
from oaisys_ros_bridge.parameters.bags import RECORDER


def rosbag2_command(folder: str, namespace: str, shared: Collection[str]) -> list[str]:
    """Return the command that records all topics of a namespace.

    rosbag2 takes a topic if an expression matches any part of its name, so these match all of it.

    Args:
        folder: The new bag.
        namespace: Without slashes at its ends; empty: the root, with all that is below it.
        shared: Full names of topics outside of the namespace that belong to it.
    """
    command = ["ros2", "bag", "record", "--storage", "mcap", "--output", folder]
    command += ["--exclude-regex", f"^({RECORDER['exclude'].default})$"]
    command += ["--exclude-topic-types", RECEIPT_TYPE]
    if not namespace:
        return [*command, "--all-topics"]
    parts = [f"/{re.escape(namespace)}/.*", *map(re.escape, sorted(shared))]
    return [*command, "--regex", f"^({'|'.join(parts)})$"]
