"""Poses in MCAP bags: stamped poses, arrays, paths, odometry and transforms.

Messages are decoded by the types that the bag describes, without ROS: Blender's process has none.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses.records import FIELD, MAX_POSES, PoseSelection, PoseTable
from oaisys_core.geometry import check_pose
from oaisys_ros_bridge.bags.mcap_format.finished_bag import open_finished
from oaisys_ros_bridge.bags.mcap_format.mcap_records import list_names, printable
from oaisys_ros_bridge.bags.mcap_format.message_decoding import DECODE_ERRORS, decoder_of
from oaisys_ros_bridge.bags.reading import files_of_bag
from oaisys_ros_bridge.bags.recorded.recorded_transforms import (
    StampedPose,
    TransformTree,
    poses_of_frame,
    unique_frame,
)

TF_TYPE = "tf2_msgs/msg/TFMessage"
STATIC_SUFFIX = "tf_static"
BASE_FRAME = "base_link"
NANOSECONDS = 10**9

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class DecodedMessage:
    """A message of a topic.

    Attributes:
        place: Where it is in the bag, for errors.
        content: Its fields, as attributes.
    """

    topic: str
    place: str
    content: Any


def read_recorded_poses(path: Path, selection: PoseSelection) -> PoseTable:
    """Return the poses of a topic of a bag.

    Args:
        path: The bag's folder, or one file of it.
        selection: Topic and frame.

    Raises:
        InvalidInputError: The bag or a message is damaged, has no such topic or frame, or several
            topics have poses and none is named.
    """
    files = files_of_bag(path)
    types = _topic_types(files)
    topic = _choose_topic(path, types, selection)
    if types[topic] == TF_TYPE:
        return _transforms(files, path, types, topic, selection.frame or BASE_FRAME)
    found = [
        (message.place, *_READERS[types[topic]](message))
        for message in _messages(files, path, (topic,))
    ]
    if not found:
        raise InvalidInputError("topic", topic, "a topic with messages")
    poses, timed = _poses_of(found, types[topic], path, topic)
    _check_body(found, selection.frame, topic)
    unique_frame({frame for _, _, frame, _ in found}, topic)
    return _table(path, poses, timed=timed)


def _topic_types(files: Sequence[Path]) -> dict[str, str]:
    types: dict[str, str] = {}
    for file in files:
        with open_finished(file) as (_, summary):
            for channel in summary.channels.values():
                types[channel.topic] = summary.schemas[channel.schema_id].name
    return types


def _choose_topic(path: Path, types: dict[str, str], selection: PoseSelection) -> str:
    usable = {name: kind for name, kind in types.items() if kind in (*_READERS, TF_TYPE)}
    offered = {name: kind for name, kind in usable.items() if not name.endswith(STATIC_SUFFIX)}
    if selection.frame is not None and selection.topic is None:
        offered = {name: kind for name, kind in offered.items() if kind == TF_TYPE} or offered
    told = list_names(f"{name} ({kind})" for name, kind in offered.items())
    if selection.topic is None:
        if len(offered) == 1:
            return next(iter(offered))
        if offered:
            raise InvalidInputError("topic", None, f"the name of one with poses: {told}")
    else:
        matching = [name for name in usable if name.strip("/") == selection.topic.strip("/")]
        if matching:
            return matching[0]
        if selection.topic in types:
            told = f"{told or 'none'}, not one of {printable(types[selection.topic])}"
    kinds = ", ".join(sorted({*_READERS, TF_TYPE}))
    expected = f"a topic of {path} with poses: {told}" if told else f"a bag with poses ({kinds})"
    raise InvalidInputError("topic", selection.topic, expected)


def _messages(
    files: Sequence[Path], path: Path, topics: Collection[str]
) -> Iterator[DecodedMessage]:
    """Yield the decoded messages of some topics in the order in which they were received.

    Raises:
        InvalidInputError: One cannot be decoded; names its number, or its type.
    """
    counts = dict.fromkeys(topics, 0)
    for file in files:
        with open_finished(file) as (bag, _):
            for schema, channel, message in bag.iter_messages(topics):
                counts[channel.topic] += 1
                place = f"{path}: {channel.topic}, message {counts[channel.topic]}"
                described = f"{path}: the type of {channel.topic}"
                decode = decoder_of(channel.message_encoding, schema, described)
                try:
                    content = None if decode is None else decode(message.data)
                except DECODE_ERRORS as error:
                    expected = f"a message as the bag describes it ({error})"
                    raise InvalidInputError(place, message.data[:20], expected) from error
                if content is None:
                    received = (channel.message_encoding, schema and schema.encoding)
                    expected = "messages of ROS 2: CDR, described in ros2msg"
                    raise InvalidInputError(place, received, expected)
                yield DecodedMessage(channel.topic, place, content)


_Read = tuple[list[StampedPose], str, str]
"""Poses of a message, the frame that they are in, and that of the body, if it says so."""


def _numbers(place: str, position: Any, orientation: Any, stamp: Any | None) -> StampedPose:
    try:
        position_m = [float(getattr(position, axis)) for axis in "xyz"]
        quat = [float(getattr(orientation, axis)) for axis in "xyzw"]
        stamp_ns = None if stamp is None else stamp.sec * NANOSECONDS + stamp.nanosec
    except DECODE_ERRORS as error:
        expected = f"a pose as ROS defines it ({error})"
        raise InvalidInputError(place, str(position), expected) from error
    pose = check_pose(position_m, quat, place)
    return StampedPose(stamp_ns, pose.position_m, pose.quat_xyzw, place)


def _stamped(message: DecodedMessage, pose: Any, body: str = "") -> _Read:
    header = message.content.header
    read = _numbers(message.place, pose.position, pose.orientation, header.stamp)
    return [read], header.frame_id, body


def _array(message: DecodedMessage) -> _Read:
    poses = [
        _numbers(f"{message.place}, pose {index}", pose.position, pose.orientation, None)
        for index, pose in enumerate(message.content.poses, start=1)
    ]
    return poses, message.content.header.frame_id, ""


def _path(message: DecodedMessage) -> _Read:
    poses, frames = [], {message.content.header.frame_id}
    for index, each in enumerate(message.content.poses, start=1):
        place = f"{message.place}, pose {index}"
        poses.append(_numbers(place, each.pose.position, each.pose.orientation, each.header.stamp))
        frames.add(each.header.frame_id)
    frames.discard("")
    if len(frames) > 1:
        raise InvalidInputError(message.place, sorted(frames), "poses in one frame")
    return poses, next(iter(frames), ""), ""


def _transform(message: DecodedMessage) -> _Read:
    moved, header = message.content.transform, message.content.header
    read = _numbers(message.place, moved.translation, moved.rotation, header.stamp)
    return [read], header.frame_id, message.content.child_frame_id


_READERS: dict[str, Callable[[DecodedMessage], _Read]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: _stamped(m, m.content.pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: _stamped(m, m.content.pose.pose),
    "geometry_msgs/msg/PoseArray": _array,
    "geometry_msgs/msg/TransformStamped": _transform,
    "nav_msgs/msg/Odometry": lambda m: _stamped(m, m.content.pose.pose, m.content.child_frame_id),
    "nav_msgs/msg/Path": _path,
}
"""What reads a message, by its type."""

_LISTS = ("geometry_msgs/msg/PoseArray", "nav_msgs/msg/Path")
"""Types of whose messages each has all poses."""


def _poses_of(
    found: Sequence[tuple[str, list[StampedPose], str, str]], kind: str, path: Path, topic: str
) -> tuple[list[StampedPose], bool]:
    """Return the poses of a topic's messages, and whether their stamps are times."""
    if kind in _LISTS:
        if len(found) > 1:
            _LOG.warning("%s: of %d messages of %s the last counts", path, len(found), topic)
        poses = found[-1][1]
    else:
        poses = [pose for _, read, _, _ in found for pose in read]
    if not poses:
        raise InvalidInputError("topic", topic, "messages with at least one pose")
    stamps = {pose.stamp_ns for pose in poses}
    # Planners stamp all poses of a path alike, or not at all.
    return poses, stamps not in ({None}, {0}) and (len(stamps) > 1 or kind not in _LISTS)


def _check_body(
    found: Sequence[tuple[str, list[StampedPose], str, str]], frame: str | None, topic: str
) -> None:
    if frame is None:
        return
    bodies = sorted({body for _, _, _, body in found})
    if bodies != [frame]:
        expected = f"the frame of the bodies of {topic}: {', '.join(bodies) or 'it says none'}"
        raise InvalidInputError("frame", frame, expected)


def _transforms(
    files: Sequence[Path], path: Path, types: dict[str, str], topic: str, frame: str
) -> PoseTable:
    prefix = topic.rpartition("tf")[0]
    fixed = [
        name
        for name, kind in types.items()
        if kind == TF_TYPE and name in (f"{prefix}{STATIC_SUFFIX}", f"/{STATIC_SUFFIX}")
    ]
    tree = TransformTree()
    for message in _messages(files, path, (topic, *fixed)):
        for each in message.content.transforms:
            moved = each.transform
            read = _numbers(message.place, moved.translation, moved.rotation, each.header.stamp)
            is_fixed = message.topic in fixed
            tree.add(each.header.frame_id, each.child_frame_id, read, is_fixed=is_fixed)
    return _table(path, poses_of_frame(tree, frame, path), timed=True)


def _table(path: Path, poses: Sequence[StampedPose], *, timed: bool) -> PoseTable:
    if len(poses) > MAX_POSES:
        raise InvalidInputError(FIELD, f"{len(poses)} poses in {path}", f"at most {MAX_POSES}")
    return PoseTable(
        path,
        np.array([pose.position_m for pose in poses]),
        np.array([pose.quat_xyzw for pose in poses]),
        tuple(pose.place for pose in poses),
        # Integers divided once are rounded once.
        np.array([(pose.stamp_ns or 0) / NANOSECONDS for pose in poses]) if timed else None,
    )
