"""Node ``oaisys_recorder``: records topics to a rosbag2 MCAP bag."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_core.files.folders import user_path
from oaisys_ros_bridge.bags.announced_samples import AnnouncedSamples
from oaisys_ros_bridge.bags.info import MOTION_TYPES, SAMPLE_INFO_TYPE, is_moving_tf
from oaisys_ros_bridge.bags.losses import BagLosses
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_class
from oaisys_ros_bridge.bags.mcap_format.serialized_stamps import StampReader, stamp_reader
from oaisys_ros_bridge.bags.topic_selection import (
    TopicSelection,
    describe_topic,
    subscription_qos,
)
from oaisys_ros_bridge.bags.wire_names import WireNames
from oaisys_ros_bridge.bags.writing import BagWriter
from oaisys_ros_bridge.nodes.node_process import run_node
from oaisys_ros_bridge.nodes.program_arguments import node_parser, parse_arguments
from oaisys_ros_bridge.parameters.bags import RECORDER
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.private.waiting_messages import take_waiting
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.subscribing.sample_watch import counting_losses
from oaisys_ros_bridge.timers import steady_timer

WARNING_PERIOD_S = 3.0
"""How often requested topics without a publisher are looked for, to warn of them."""
DISCOVERY_PERIOD_S = 0.25
"""How often new topics are looked for."""
QUIET_LOOKUPS = 6
"""After this many look-ups without a new topic, all that exist count as found. Discovery does not
say when it is complete: only of requested topics it is certain that they are recorded by then."""
ANSWER_S = 1.0
"""For a bridge, which may end at the same signal, to say which sample is the last."""
END_LOOK_S, QUIET_LOOKS = 0.02, 25
"""At the end, recording goes on until all messages of every announced sample are there. The end of
other topics is not announced: recording also goes on until so many looks, at least this long after
each other, have found none that was published before ..."""
LONGEST_END_S = 8.0
"""... but no longer than this; what is left then is counted. Launch files wait longer."""
BUSY_S = 1.0
"""Longest time for which, after that, a message is waited for that is being written."""
TAKEN_AT_ONCE = 500
"""Messages of one topic that are taken, at the end, before it is the next one's turn."""
MIN_FREE_BYTES = 64 * 2**20


class RecorderNode(ParameterNode, Node):
    """Records serialised messages without deserialising them.

    A topic is subscribed to, and recorded, under the name that it has on the wire: rules that remap
    the recorder's own names say which topics are meant, and rename none of them in the bag.

    Its parameters are the table `RECORDER`; `TopicSelection` says what *all* topics are.

    It always subscribes to ``sample_info``, where it exists, and counts which messages of the
    announced samples it has not received. The counts are in its receipts, for which the bridge
    waits, in the bag, and in its last line.

    Once it is subscribed to all requested topics (or to all that exist), it prints ``recording:
    PATH`` and publishes true on the latched ``~/recording``. Where the bag cannot be written, as on
    a full disk, recording ends with one error: what comes until the bag is closed is counted.

    Attributes:
        fault: Why the bag could not be written, or not be closed; empty: it could.
    """

    def __init__(self, stop: threading.Event, **defaults: Any) -> None:
        """Begin to record.

        Args:
            stop: Set after ``duration_s``, and where the bag cannot be written.
            defaults: Of the parameters, instead of the table's.

        Raises:
            InvalidInputError: The folder is not empty, the disk is full, or a parameter is wrong.
            OSError: The folder cannot be written.
        """
        super().__init__("oaisys_recorder")
        values = self.declare_table(RECORDER, **defaults)
        self._selection = TopicSelection.of(self, values)
        name = values["path"] or time.strftime("bag_%Y_%m_%d-%H_%M_%S")
        self._folder = user_path(name, "path")
        require_free_space(self._folder)
        self._bag = BagWriter(self._folder)
        self._stop = stop
        self.fault = ""
        self._bag_lock = threading.Lock()
        self._subscribed: dict[str, Subscription] = {}
        self._wire = WireNames(self)
        self._transforms: set[str] = set()
        self._not_installed: set[str] = set()
        self._quiet_lookups = 0
        self._is_ready = False
        self._has_ended = False
        self._written_at_end = 0
        self._end_asked_ns = sys.maxsize
        self._is_late = False
        self._unwritten: Counter[str] = Counter()
        self._losses = BagLosses()
        self._samples = AnnouncedSamples(self._wire, self._is_recorded)
        self._stamp_readers: dict[str, StampReader] = {}
        self._recording = self.create_publisher(Bool, "~/recording", LATCHED_QOS)
        self._missing = ""
        group = self.default_callback_group
        steady_timer(self, DISCOVERY_PERIOD_S, self._discover, group)
        steady_timer(self, WARNING_PERIOD_S, self._warn_of_missing, group)
        if values["duration_s"]:
            steady_timer(self, values["duration_s"], stop.set, group)

    def close(self) -> None:
        """Record what was published before, count what there is no time for, close the bag."""
        try:
            self._record_waiting()
        finally:
            with self._bag_lock:
                # Callbacks may still run until the executor has ended.
                if not self._has_ended:
                    self._end()
        self._tell()

    def _tell(self) -> None:
        """Say what the bag holds, and what it lacks."""
        told = f"{self._bag.message_count} messages in {self._folder}"
        if self._bag.is_there:
            told = "; ".join([told, *self._losses.sentences])
        else:
            told = f"{told} are gone with its file"
        if self.fault:
            self.get_logger().error(f"{told}; the recording has failed: {self.fault}")
        elif self._losses.any:
            self.get_logger().warning(told)
        else:  # rclpy wants a line of its own for each severity
            self.get_logger().info(told)

    def _record_waiting(self) -> None:
        """Record what was published before the end was asked for, as long as there is time."""
        self._end_asked_ns = time.time_ns()
        end_s = time.monotonic() + LONGEST_END_S
        if not self.fault:
            self._samples.hear_newest(ANSWER_S)
        quiet_looks = 0
        while (
            not self.fault
            and time.monotonic() < end_s
            and (quiet_looks < QUIET_LOOKS or self._samples.is_any_open)
        ):
            before = self._written_at_end
            self._take_waiting()
            time.sleep(END_LOOK_S)
            quiet_looks = quiet_looks + 1 if self._written_at_end == before else 0
        with self._bag_lock:
            self._is_late = True
        came = is_busy = True
        while came or (is_busy and time.monotonic() < end_s + BUSY_S):
            came, is_busy = self._take_waiting()
            time.sleep(0.001)

    def _take_waiting(self) -> tuple[bool, bool]:
        """Take messages that wait, faster than the executor does, which wakes up for each of them.

        It serves no topic that is being served here, and one that it is serving is left to it.

        Returns:
            Whether any was published before the end was asked for, and whether any topic was left.
        """
        came = is_busy = False
        for topic in list(self._subscribed.values()):
            if not topic.callback_group.beginning_execution(topic):
                is_busy = True
                continue
            try:
                with topic.handle:
                    for _ in range(TAKEN_AT_ONCE):
                        if (taken := take_waiting(topic)) is None:
                            break
                        topic.callback(*taken)
                        came |= taken[1]["source_timestamp"] <= self._end_asked_ns
            finally:
                topic.callback_group.ending_execution(topic)
        return came, is_busy

    def _discover(self) -> None:
        """Subscribe to new topics, and report once all of them are there."""
        if self.fault:
            return
        has_found = False
        for name, (type_name, *_) in self.get_topic_names_and_types():
            if type_name == SAMPLE_INFO_TYPE and self._selection.is_near(name):
                self._samples.follow(name)
            if self._is_new(name, type_name):
                self._subscribe(name, type_name)
                has_found = True
        connected = all(s.get_publisher_count() > 0 for s in self._subscribed.values())
        self._quiet_lookups = 0 if has_found or not connected else self._quiet_lookups + 1
        if (
            not self._is_ready
            and not self._topics_without_publisher
            and self._quiet_lookups >= QUIET_LOOKUPS
        ):
            self._report_ready()

    def _is_new(self, name: str, type_name: str) -> bool:
        """Return whether a topic is to be recorded, has a publisher, and is not recorded yet."""
        if name in self._subscribed or name in self._not_installed:
            return False
        return self._includes(name, type_name) and bool(self.count_publishers(name))

    def _includes(self, name: str, type_name: str = "") -> bool:
        """Return whether a topic is to be recorded; its own is not, unless it is asked for."""
        is_own = name == self._recording.topic_name and name not in self._selection.requested
        return not is_own and self._selection.includes(name, type_name)

    def _is_recorded(self, name: str) -> bool:
        """Return whether messages of a topic are recorded, once there are any."""
        return name not in self._not_installed and self._includes(name)

    @property
    def _topics_without_publisher(self) -> set[str]:
        """Requested topics that have had no publisher yet."""
        return set(self._selection.requested) - self._subscribed.keys()

    def _report_ready(self) -> None:
        self._is_ready = True
        self._samples.begin(time.time_ns(), self._subscribed)
        self._recording.publish(Bool(data=True))
        sys.stdout.write(f"recording: {self._folder}\n")
        sys.stdout.flush()

    def _warn_of_missing(self) -> None:
        """Warn of requested topics that nobody publishes, once for the same ones."""
        missing = ", ".join(sorted(self._topics_without_publisher))
        if missing and missing != self._missing:
            self.get_logger().warning(f"nobody publishes {missing} yet")
        self._missing = missing

    def _subscribe(self, name: str, type_name: str) -> None:
        """Subscribe to a topic, unless it has lost its publishers or its type is not installed."""
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return
        try:
            message_type = message_class(type_name)
            with self._bag_lock:
                if self._has_ended:
                    return
                self._bag.add_topic(describe_topic(name, type_name, publishers))
        except NotFoundError as error:
            self._not_installed.add(name)
            self.get_logger().warning(f"{name} is not recorded: {error}")
            return
        except OSError as error:
            self._give_up(str(error))
            return
        if (read_stamp := stamp_reader(message_type)) is not None:
            self._stamp_readers[name] = read_stamp
        if is_moving_tf(name, type_name):
            self._transforms.add(name)
        qos = subscription_qos(type_name, publishers)
        # No sample announces messages of motion, so their sequence numbers are checked for gaps.
        is_motion = type_name in MOTION_TYPES
        self._subscribed[name] = self._wire.node_for(name).create_subscription(
            message_type,
            name,
            partial(self._record, name, is_motion),
            qos,
            raw=True,
            # In a common group the executor would serve one topic and starve the others.
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=None
            if is_motion
            else counting_losses(self._samples.lost_by_middleware, name, qos),
        )

    def destroy_node(self) -> None:
        """Destroy it, and the node beside it."""
        self._wire.destroy()
        super().destroy_node()

    def _record(self, name: str, is_motion: bool, data: bytes, info: dict[str, int]) -> None:
        if is_motion:
            self._samples.count_missing(name, info["publication_sequence_number"])
        was_before_end = info["source_timestamp"] <= self._end_asked_ns
        with self._bag_lock:
            if self._is_late or self.fault:
                self._unwritten[name] += was_before_end
                return
            if self._has_ended:
                return
            received_ns = self.get_clock().now().nanoseconds
            try:
                self._bag.write(name, data, received_ns, info["source_timestamp"])
            except OSError as error:
                self._unwritten[name] += 1
                self._give_up(str(error))
                return
        # A bridge repeats its transforms without end.
        if was_before_end and name not in self._transforms:
            self._written_at_end += self._end_asked_ns < sys.maxsize
        if (read_stamp := self._stamp_readers.get(name)) and (stamp_ns := read_stamp(data)):
            self._samples.arrive(name, stamp_ns)

    def _end(self) -> None:
        """Count what has not been received as lost, and close the bag."""
        self._has_ended = True
        self._samples.give_up_all()
        self._samples.end()
        self._losses = self._samples.losses(self._unwritten)
        try:
            self._bag.close(self._losses)
        except OSError as error:
            self.fault = self.fault or str(error)
            self.get_logger().error(f"{self._folder} has no summary: {error}")

    def _give_up(self, reason: str) -> None:
        """Write nothing more, because that is impossible, and have the program end."""
        self.fault = reason
        self._recording.publish(Bool(data=False))
        self.get_logger().error(f"recording to {self._folder} has ended: {reason}")
        self._stop.set()


def require_free_space(folder: Path) -> None:
    """Raise `InvalidInputError` where the disk has no room for a bag."""
    existing = next(parent for parent in folder.resolve().parents if parent.exists())
    free = shutil.disk_usage(existing).free
    if free < MIN_FREE_BYTES:
        raise InvalidInputError(
            "path", str(folder), f"{MIN_FREE_BYTES >> 20} MB free, not {free >> 20}"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Record until SIGINT, SIGTERM or a write error."""
    parser = node_parser("recorder")
    parser.add_argument("--out", default="", help="folder of the bag; new or empty")
    parser.add_argument("--topics", nargs="*", default=(), help="topics to record; default: all")
    parser.add_argument(
        "--all", action="store_true", help="record all other topics beside --topics, too"
    )
    options, arguments = parse_arguments(parser, arguments)
    return run_recorder(arguments, path=options.out, topics=["", *options.topics], all=options.all)


def run_recorder(arguments: Sequence[str], **defaults: Any) -> int:
    """Record until SIGINT, SIGTERM, ``duration_s`` or a write error, after which it returns 1.

    Args:
        arguments: Of the program, with its name.
        defaults: Of parameters.
    """
    stop = threading.Event()
    recorders: list[RecorderNode] = []

    def make_node() -> RecorderNode:
        recorders.append(RecorderNode(stop, **defaults))
        return recorders[-1]

    code = run_node(make_node, arguments, stop=stop)
    return code or int(any(recorder.fault for recorder in recorders))


if __name__ == "__main__":
    sys.exit(main())
