"""Node ``oaisys_recorder``: writes topics to a rosbag2 MCAP bag as they come."""

from __future__ import annotations

import argparse
import re
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
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Bool

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bags.info import SAMPLE_INFO_TYPE, TF_TYPE
from oaisys_ros_bridge.bags.losses import BagLosses
from oaisys_ros_bridge.bags.message_definition import message_class
from oaisys_ros_bridge.bags.serialized_stamps import StampReader, stamp_reader
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic, qos_entry
from oaisys_ros_bridge.namespaces import TF
from oaisys_ros_bridge.nodes.node_process import OWN_CLOCK, run_node
from oaisys_ros_bridge.parameters.bags import RECORDER
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.qos import LATCHED_QOS, SMALL_MESSAGE_QOS
from oaisys_ros_bridge.subscribing.sample_watch import (
    SAMPLE_INFO,
    SampleWatch,
    counting_losses,
    name_of,
)

TELL_PERIOD_S = 3.0
"""Between two looks at which topics are still without a publisher."""
LOOK_PERIOD_S = 0.25
"""Between two looks for topics that have appeared."""
CALM_LOOKS = 6
"""Looks without anything new after which all topics that exist count as found. Discovery gives no
sign of its end: only named topics are certain to be listened to by then."""
QUEUE_DEPTH = 50
"""Messages of a topic that may wait; the bridge waits long before they are so many."""
QUEUE_DEPTHS = {SAMPLE_INFO_TYPE: SMALL_MESSAGE_QOS.depth, TF_TYPE: SMALL_MESSAGE_QOS.depth}
"""Of small messages, by their type; transforms come from others, too, and are repeated."""
LAST_MESSAGES_S = 0.5
"""At the end, recording goes on until all has come of every announced sample. Of what no sample
announces nobody tells the end: until nothing has come for this long ..."""
LONGEST_END_S = 3.0
"""... but no longer than this."""
RECEIPT_TYPE = "oaisys_msgs/msg/SampleReceipt"
LEAST_FREE_BYTES = 64 * 2**20


class RecorderNode(ParameterNode, Node):
    """Records serialised messages without looking into them.

    Its parameters are the table `RECORDER`. *All* topics are those that exist or appear in the
    node's own namespace, and ROS's own at the root, such as ``/tf`` and ``/diagnostics``; hidden
    ones, receipts, and what ``exclude`` matches, apart.

    It listens to ``sample_info`` in any case, where there is one, and counts against it what it has
    lost: in receipts, which the bridge waits for, in the bag, and at the end.

    Once it listens to all requested topics (or to all that exist), it prints ``recording: PATH``
    and publishes true on the latched ``~/recording``. A full disk ends the recording with one
    error; the node stays, the bag is closed.
    """

    def __init__(self, stop: threading.Event, **defaults: Any) -> None:
        """Begin to record.

        Args:
            stop: Set when the time is over.
            defaults: Of the parameters, instead of the table's.

        Raises:
            InvalidInputError: Something is in the folder, or there is no room; a parameter is bad.
            OSError: The folder cannot be written.
        """
        super().__init__("oaisys_recorder")
        values = self.declare_table(RECORDER, **defaults)
        self._requested = {self.resolve_topic_name(name) for name in values["topics"] if name}
        self._everything = values["all"] or not self._requested
        self._exclude = re.compile(values["exclude"])
        self._folder = Path(values["path"] or time.strftime("bag_%Y_%m_%d-%H_%M_%S"))
        require_free_space(self._folder)
        self._bag = BagWriter(self._folder)
        self._bag_lock = threading.Lock()
        self._listening: dict[str, Subscription] = {}
        self._unknown: set[str] = set()
        self._calm_looks = 0
        self._announced = False
        self._ended = False
        self._last_message_s = 0.0
        self._losses = BagLosses()
        self._lost_by_middleware: Counter[str] = Counter()
        self._watches: dict[str, SampleWatch] = {}
        self._stamped: dict[str, StampReader] = {}
        self._counted: set[str] = set()
        self._recording = self.create_publisher(Bool, "~/recording", LATCHED_QOS)
        self._own_topics = {self._recording.topic_name}
        self.create_timer(LOOK_PERIOD_S, self._look, clock=OWN_CLOCK)
        if values["duration_s"]:
            self.create_timer(values["duration_s"], stop.set, clock=OWN_CLOCK)
        self._told_missing = ""
        self.create_timer(TELL_PERIOD_S, self._tell_missing, clock=OWN_CLOCK)

    def close(self) -> None:
        """Take in what is still on its way, then finish the bag."""
        end_s = time.monotonic() + LONGEST_END_S
        self._last_message_s = time.monotonic()
        while time.monotonic() < min(end_s, self._last_message_s + LAST_MESSAGES_S) or (
            time.monotonic() < end_s and any(w.ledger.open for w in self._watches.values())
        ):
            time.sleep(0.02)
        with self._bag_lock:
            # Callbacks may still come until the executor has ended.
            if not self._ended:
                self._end()
        lost = "; ".join(self._losses.sentences)
        told = f"{self._bag.message_count} messages in {self._folder}; {lost}"
        (self.get_logger().warning if self._losses.any else self.get_logger().info)(told)

    def _look(self) -> None:
        """Listen to topics that have appeared, and say when all of them are there."""
        found = False
        for name, types in self.get_topic_names_and_types():
            if types[0] == SAMPLE_INFO_TYPE and name not in self._watches and self._is_near(name):
                self._watch(name)
            if types[0] == RECEIPT_TYPE and name not in self._requested:
                continue  # played again, they would tell a bridge of readers that are not there
            if name not in self._listening and name not in self._unknown and self._wants(name):
                self._listen(name, types[0])
                found = True
        connected = all(s.get_publisher_count() > 0 for s in self._listening.values())
        self._calm_looks = 0 if found or not connected else self._calm_looks + 1
        complete = self._requested <= self._listening.keys()
        if not self._announced and complete and self._calm_looks >= CALM_LOOKS:
            self._announced = True
            self._counted |= self._listening.keys()
            self._recording.publish(Bool(data=True))
            sys.stdout.write(f"recording: {self._folder}\n")
            sys.stdout.flush()

    def _tell_missing(self) -> None:
        """Say, once, which topics that are asked for have no publisher."""
        missing = ", ".join(sorted(self._requested - self._listening.keys()))
        if missing and missing != self._told_missing:
            self.get_logger().warning(f"nobody publishes {missing} yet")
        self._told_missing = missing

    def _wants(self, name: str) -> bool:
        if name in self._requested or not self._everything:
            return name in self._requested
        hidden = any(part.startswith("_") for part in name.split("/"))
        if (
            hidden
            or not self._is_near(name)
            or name in self._own_topics
            or self._exclude.fullmatch(name)
        ):
            return False
        return bool(self.count_publishers(name))

    def _is_near(self, name: str) -> bool:
        """Return whether a topic is in the node's own namespace, or at the root."""
        return name.count("/") == 1 or name.startswith(f"{self.get_namespace().rstrip('/')}/")

    def _watch(self, name: str) -> None:
        """Count from now on against a topic that announces samples."""
        if name.rpartition("/")[2] != SAMPLE_INFO:
            return
        watch = self._watches[name] = SampleWatch(self, name, self._lost_by_middleware)
        self.create_subscription(
            SampleInfo,
            name,
            partial(self._announce, watch),
            SMALL_MESSAGE_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=counting_losses(self._lost_by_middleware, name),
        )

    def _announce(self, watch: SampleWatch, info: SampleInfo) -> None:
        """Expect what was published of a sample, as far as it is listened to."""
        watch.ledger.announce(name_of(info), info.sequence, self._counted & set(info.topics))

    def _listen(self, name: str, type_name: str) -> None:
        """Subscribe with a quality of service that fits all publishers of the topic."""
        offers = self.get_publishers_info_by_topic(name)
        if not offers:
            return
        topic = RecordedTopic(name, type_name, tuple(_offered(offer) for offer in offers))
        try:
            message_type = message_class(type_name)
            with self._bag_lock:
                self._bag.add_topic(topic)
        except NotFoundError as error:
            self._unknown.add(name)
            self.get_logger().warning(f"{name} is not recorded: {error}")
            return
        reliable = all(_is_reliable(offer) for offer in offers)
        latched = all(_is_latched(offer) for offer in offers)
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        if (read_stamp := stamp_reader(message_type)) is not None:
            self._stamped[name] = read_stamp
        depth = QUEUE_DEPTHS.get(type_name, QUEUE_DEPTH)
        self._listening[name] = self.create_subscription(
            message_type,
            name,
            partial(self._record, name),
            QoSProfile(depth=depth, reliability=reliability, durability=durability),
            raw=True,
            # Of one group the executor takes whichever topic comes first, and starves the others.
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=counting_losses(self._lost_by_middleware, name),
        )

    def _record(self, name: str, data: bytes, info: dict[str, int]) -> None:
        with self._bag_lock:
            if self._ended:
                return
            received_ns = self.get_clock().now().nanoseconds
            try:
                self._bag.write(name, data, received_ns, info["source_timestamp"])
            except OSError as error:
                self._give_up(str(error))
                return
        if not name.endswith(TF):  # a bridge repeats its transforms for ever
            self._last_message_s = time.monotonic()
        if (read_stamp := self._stamped.get(name)) and (stamp_ns := read_stamp(data)):
            self._counted.add(name)
            for watch in self._watches.values():
                watch.ledger.arrive(name, stamp_ns)

    def _end(self) -> None:
        """Count what has not come as lost, and finish the bag."""
        self._ended = True
        for watch in self._watches.values():
            watch.ledger.give_up_all()
            watch.end()
        self._finish()

    def _give_up(self, reason: str) -> None:
        self._ended = True
        for watch in self._watches.values():
            watch.end()
        self._recording.publish(Bool(data=False))
        self.get_logger().error(f"recording to {self._folder} has ended: {reason}")
        self._finish()

    def _finish(self) -> None:
        states = [watch.ledger.state for watch in self._watches.values()]
        self._losses = BagLosses.of(states, self._lost_by_middleware)
        try:
            self._bag.close(self._losses)
        except OSError as error:
            self.get_logger().error(f"{self._folder} has no summary: {error}")


def require_free_space(folder: Path) -> None:
    """Raise `InvalidInputError` where there is no room to start a bag."""
    existing = next(parent for parent in folder.resolve().parents if parent.exists())
    free = shutil.disk_usage(existing).free
    if free < LEAST_FREE_BYTES:
        raise InvalidInputError(
            "path", str(folder), f"{LEAST_FREE_BYTES >> 20} MB free, not {free >> 20}"
        )


def _offered(offer: TopicEndpointInfo) -> dict[str, Any]:
    return qos_entry(
        depth=offer.qos_profile.depth,
        reliable=_is_reliable(offer),
        transient_local=_is_latched(offer),
    )


def _is_reliable(offer: TopicEndpointInfo) -> bool:
    return bool(offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE)


def _is_latched(offer: TopicEndpointInfo) -> bool:
    return bool(offer.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def main(arguments: Sequence[str] | None = None) -> int:
    """Record until told to end."""
    arguments = list(sys.argv if arguments is None else arguments)
    parser = argparse.ArgumentParser(prog="recorder", description="Record a rosbag2 MCAP bag.")
    parser.add_argument("--out", default="", help="folder of the bag; new or empty")
    parser.add_argument("--topics", nargs="*", default=(), help="default: all")
    parser.add_argument("--all", action="store_true", help="beside --topics: all others too")
    own = parser.parse_args(remove_ros_args(arguments)[1:])
    given = {"path": own.out, "topics": ["", *own.topics], "all": own.all}
    return run_recorder(arguments, **given)


def run_recorder(arguments: Sequence[str], **defaults: Any) -> int:
    """Record until told to end; ``defaults`` are those of the parameters."""
    stop = threading.Event()
    return run_node(lambda: RecorderNode(stop, **defaults), arguments, stop=stop)


if __name__ == "__main__":
    sys.exit(main())
