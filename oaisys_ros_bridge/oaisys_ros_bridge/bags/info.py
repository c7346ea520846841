"""Describes what is in a bag: topics, message counts, and what its recorder has lost."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mcap.summary import Summary

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.losses import METADATA_NAME, BagLosses
from oaisys_ros_bridge.bags.mcap_format.finished_bag import FINISHED, FinishedBag, open_finished
from oaisys_ros_bridge.bags.mcap_format.mcap_records import printable
from oaisys_ros_bridge.bags.mcap_format.serialized_stamps import knows_twist
from oaisys_ros_bridge.bags.reading import mcap_file

SAMPLE_INFO_TYPE = "oaisys_msgs/msg/SampleInfo"
TF_TYPE = "tf2_msgs/msg/TFMessage"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
IMU_TYPE = "sensor_msgs/msg/Imu"
MOTION_TYPES = (ODOMETRY_TYPE, IMU_TYPE)
"""Types of small messages of which a drive has many between two samples, besides transforms."""


def summary_of(path: Path) -> list[str]:
    """Return a line for the bag, one per topic (name, type, messages), and what it has lost.

    Transforms and odometry that a bridge repeated are counted apart from those of samples and
    drives. Only bags of this package's recorder say what they have lost.

    Args:
        path: A bag's folder with one ``.mcap`` file in it, or that file.

    Raises:
        InvalidInputError: There is no such file, or it is not a finished MCAP file.
    """
    file = mcap_file(path)
    with open_finished(file) as (reader, summary):
        repeats = repeats_of(reader, summary)
        losses = _losses(reader)
    statistics = summary.statistics
    if statistics is None:
        raise InvalidInputError("bag", str(file), FINISHED)
    span_s = (statistics.message_end_time - statistics.message_start_time) / 1e9
    lines = [f"{file}: {statistics.message_count} messages, {span_s:.1f} s"]
    lines += _topic_lines(summary, statistics.channel_message_counts, repeats)
    if losses is not None:
        lines += [f"  {sentence}" for sentence in losses.sentences]
    return lines


def _topic_lines(
    summary: Summary, counts: Mapping[int, int], repeats: Mapping[str, int]
) -> list[str]:
    rows = sorted(
        (
            printable(channel.topic),
            printable(summary.schemas[channel.schema_id].name),
            counts.get(channel.id, 0),
        )
        for channel in summary.channels.values()
    )
    width = max((len(topic) for topic, _, _ in rows), default=0)
    lines = []
    for topic, type_name, count in rows:
        repeated = repeats.get(topic, 0)
        suffix = f" and {repeated} repeats" if repeated else ""
        lines.append(f"  {topic:<{width}}  {type_name}  {count - repeated}{suffix}")
    return lines


def losses_of(path: Path) -> BagLosses | None:
    """Return what a bag says that its recorder has lost; None: it does not say.

    Raises:
        InvalidInputError: There is no such file, or it is not a finished MCAP file.
    """
    with open_finished(mcap_file(path)) as (reader, _):
        return _losses(reader)


def _losses(reader: FinishedBag) -> BagLosses | None:
    entries = reader.metadata(METADATA_NAME)
    return None if entries is None else BagLosses.read(entries)


def is_moving_tf(topic: str, type_name: str) -> bool:
    """Return whether a topic has transforms that change, whatever it was remapped to."""
    return type_name == TF_TYPE and not topic.endswith("_static")


def repeats_of(reader: FinishedBag, summary: Summary) -> Mapping[str, int]:
    """Return how many messages of moving TF and odometry tell again, or first, where the rig is.

    A message is a repeat if it belongs to no sample and to no time of a drive: no ``~/sample_info``
    has its stamp, no IMU, and no odometry that knows its twist. The result is empty for a bag
    without samples.
    """
    types = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    moving = {t for t, name in types.items() if is_moving_tf(t, name)}
    told = {topic for topic, name in types.items() if name == ODOMETRY_TYPE}
    samples = {topic for topic, name in types.items() if name == SAMPLE_INFO_TYPE}
    if not samples:
        return {}
    measured = {*samples, *(topic for topic, name in types.items() if name == IMU_TYPE)}
    measured_stamps: set[bytes] = set()
    stamps: list[tuple[str, bytes]] = []
    for _, channel, message in reader.iter_messages(topics=[*moving, *told, *measured]):
        # CDR: 4 bytes of header; a stamp of 8 bytes, or the number of transforms before it.
        if channel.topic in moving:
            stamps.append((channel.topic, message.data[8:16]))
        elif channel.topic in measured or knows_twist(message.data):
            measured_stamps.add(message.data[4:12])
        else:
            stamps.append((channel.topic, message.data[4:12]))
    found = dict.fromkeys((*moving, *told), 0)
    for topic, stamp in stamps:
        found[topic] += stamp not in measured_stamps
    return found
