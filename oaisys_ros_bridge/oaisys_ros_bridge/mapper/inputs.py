"""The inputs of the mapper: subscriptions, and the frames that are made of their messages."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import OaisysError
from oaisys_core.types import DEPTH, RGB
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.mapper.fusion import DepthFrame, Fusion
from oaisys_ros_bridge.private.waiting_messages import take_waiting
from oaisys_ros_bridge.qos import (
    DEEP_QOS,
    LATCHED_HISTORY_QOS,
    LATCHED_QOS,
    SMALL_MESSAGE_QOS,
)
from oaisys_ros_bridge.subscribing.foreign_names import class_names_of
from oaisys_ros_bridge.subscribing.frame_assembly import COLOR_WAIT_S, FrameAssembler
from oaisys_ros_bridge.subscribing.sample_ledger import SampleLedger
from oaisys_ros_bridge.subscribing.sample_watch import camera_poses, counting_losses, name_of
from oaisys_ros_bridge.timers import steady_timer

BATCH_TOPIC = "oaisys_bridge/batch"
SAMPLE_INFO_TOPIC = "oaisys_bridge/sample_info"
EARLY_FRAMES = 4
"""Frames of a new world that may come before its announcement."""

IN_MAP = "map"
"""The ledger's name for what is made of a sample's messages: its view in the map."""


class MapperInputs:
    """Subscribes to everything that the map is made of, and queues complete frames for fusion.

    Args:
        node: The mapper.
        values: Its parameters.
        ledger: Learns which samples are expected in the map, and which messages have come.
        fusion: Fuses the frames.
        lost_by_middleware: Counts the messages that the middleware says were lost, by topic.
        forget_map: Called with the stamp (ns) at which another world has begun.

    Attributes:
        class_names: Names of semantic ids, from the legend.
    """

    def __init__(
        self,
        node: Node,
        values: Mapping[str, Any],
        ledger: SampleLedger,
        fusion: Fusion,
        lost_by_middleware: Counter[str],
        forget_map: Callable[[int], None],
    ) -> None:
        self._node = node
        self._ledger = ledger
        self._fusion = fusion
        self._lost_by_middleware = lost_by_middleware
        self._forget_map = forget_map
        self.class_names: dict[int, str] = {}
        self._assembler = FrameAssembler(
            values["map_frame"],
            use_color=values["use_color"],
            use_semantics=values["use_semantics"],
            on_given_up=ledger.give_up,
        )
        self._lock = threading.RLock()
        self._world_heard = threading.Condition(self._lock)
        self._heard_ns = 0
        self._batch: tuple[str, int, int] | None = None
        self._batch_begin_ns = 0
        self._newest: deque[DepthFrame] = deque(maxlen=EARLY_FRAMES)
        self._subscribe(values)

    @property
    def dropouts(self) -> int:
        """How many depth images became no frame."""
        return self._assembler.dropouts

    def clear(self) -> None:
        """Forget the frames so far, and those that are incomplete."""
        with self._lock:
            self._assembler.clear()
            self._newest.clear()

    def take_announcements(self) -> None:
        """Take the ``sample_info`` messages in the queue: a request counts all earlier samples."""
        waiting = self._announcements
        while True:
            with waiting.handle:
                taken = take_waiting(waiting)
            if taken is None:
                return
            waiting.callback(taken[0])

    def hear_world(self, begin_ns: int, timeout_s: float) -> str:
        """Wait until the map is that of the world whose samples begin at a stamp, or a later one.

        Returns:
            Why it may not be; empty: it is, or the map is kept from world to world.
        """
        if not self._clears:
            return ""
        with self._world_heard:
            if self._world_heard.wait_for(lambda: self._heard_ns >= begin_ns, timeout_s):
                return ""
        return f"{BATCH_TOPIC} has not announced the newest world within {timeout_s:g} s"

    def _subscribe(self, values: Mapping[str, Any]) -> None:
        camera = values["camera"]
        assembler = self._assembler
        self._feed(TFMessage, "/tf_static", assembler.add_static, LATCHED_HISTORY_QOS)
        if values["use_odometry"]:
            pose_topic = "ground_truth/odometry"
            self._feed(Odometry, pose_topic, assembler.add_odometry, SMALL_MESSAGE_QOS)
        else:
            pose_topic = "/tf"
            self._feed(TFMessage, pose_topic, assembler.add_transforms, SMALL_MESSAGE_QOS)
        inputs: list[tuple[str, type[Any], str]] = [
            ("depth", Image, "depth/image_raw"),
            ("info", CameraInfo, "depth/camera_info"),
        ]
        level = f"semantic_{values['semantic_level']}"
        if values["use_color"]:
            inputs.append(("color", Image, "color/image_raw"))
            add_info = assembler.add_color_info
            self._feed(CameraInfo, f"{camera}/color/camera_info", add_info, DEEP_QOS)
        if values["use_semantics"]:
            inputs.append(("semantic", Image, f"{level}/image_raw"))
            legend = f"{camera}/{level}/labels"
            self._node.create_subscription(SemanticLabels, legend, self._on_labels, LATCHED_QOS)
        self._end_kinds = {RGB: "color", level: "semantic"}
        self._announcements = self._feed(
            SampleInfo, SAMPLE_INFO_TOPIC, partial(self._end_sample, camera), SMALL_MESSAGE_QOS
        )
        if values["use_color"] or values["use_semantics"]:
            group = self._node.default_callback_group
            steady_timer(self._node, COLOR_WAIT_S / 2, self._give_up_color, group)
        self._clears = values["clear_on_batch"]
        if self._clears:
            self._node.create_subscription(SampleInfo, BATCH_TOPIC, self._on_batch, LATCHED_QOS)
        for kind, message_type, topic in inputs:
            add = partial(self._add_image, kind)
            self._feed(message_type, f"{camera}/{topic}", add, DEEP_QOS)
        topics = {kind: f"{camera}/{topic}" for kind, _, topic in inputs} | {"pose": pose_topic}
        self._topics = {kind: self._node.resolve_topic_name(t) for kind, t in topics.items()}

    def _feed(
        self, kind: type[Any], topic: str, add: Callable[[Any], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe to a topic whose messages ``add`` gives to the assembler."""
        name = self._node.resolve_topic_name(topic)

        def take(message: Any) -> None:
            self._take_in(add, message)
            for stamp_ns in _stamps_of(message):
                self._ledger.arrive(name, stamp_ns)

        return self._node.create_subscription(
            kind,
            topic,
            take,
            qos,
            # In one group the executor would prefer the topic that was created first.
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=counting_losses(self._lost_by_middleware, name, qos),
        )

    def _add_image(self, kind: str, message: Any) -> None:
        self._assembler.add_image(kind, message, time.monotonic())

    def _end_sample(self, camera: str, message: SampleInfo) -> None:
        """Fuse the depth image of a complete sample, and drop those of failed samples."""
        cameras = camera_poses(message)
        modalities = {
            modality
            for sensor in cameras
            if sensor.sensor == camera or len(cameras) == 1
            for modality in sensor.modalities
        }
        stamp_ns = nanoseconds(message.header.stamp)
        kinds = [kind for modality, kind in self._end_kinds.items() if modality in modalities]
        self._assembler.end_sample(stamp_ns, time.monotonic(), kinds=kinds)
        self._expect(message, kinds if DEPTH in modalities else None)

    def _expect(self, message: SampleInfo, kinds: Sequence[str] | None) -> None:
        """Expect a sample in the map, with these images beside depth; None: it has no depth."""
        name, ledger = name_of(message), self._ledger
        if kinds is None or name.stamp_ns < self._batch_begin_ns:
            ledger.announce(name, message.sequence, ())
            return
        needed = [self._topics[kind] for kind in ("depth", "info", "pose")]
        topics = [*needed, *(self._topics[kind] for kind in kinds if kind in self._topics)]
        ledger.announce(name, message.sequence, topics, needed=needed, result=IN_MAP)

    def _on_labels(self, message: SemanticLabels) -> None:
        self.class_names = class_names_of(message)

    def _give_up_color(self) -> None:
        are_announced = self._node.count_publishers(SAMPLE_INFO_TOPIC) > 0
        give_up = partial(self._assembler.give_up_color, samples_are_announced=are_announced)
        self._take_in(give_up, time.monotonic())

    def _take_in(self, add: Callable[[Any], None], message: Any) -> None:
        """Give a message to the assembler and queue all frames that it completes."""
        with self._lock:
            try:
                add(message)
            except OaisysError as error:
                self._node.get_logger().warning(f"a message cannot be used: {error}")
            while self._fuse_next():
                pass

    def _fuse_next(self) -> bool:
        """Queue the next complete frame; return whether there was one."""
        try:
            frame = self._assembler.pop()
        except OaisysError as error:
            self._node.get_logger().warning(f"a frame cannot be used: {error}")
            return True
        if frame is None:
            return False
        if frame.stamp_ns >= self._batch_begin_ns:
            self._newest.append(frame)
            self._fuse(frame)
        return True

    def _fuse(self, frame: DepthFrame) -> None:
        if not self._fusion.add(frame):
            self._node.get_logger().warning("the queue is full: a frame is dropped")

    def _on_batch(self, message: SampleInfo) -> None:
        """Forget the map of the previous world, even if frames of the new one have come already."""
        batch = (message.config_sha256, message.seed, message.batch_id)
        with self._lock:
            known, self._batch = self._batch, batch
            self._heard_ns = nanoseconds(message.header.stamp)
            self._world_heard.notify_all()
            if known in (None, batch):
                return
            self._batch_begin_ns = self._heard_ns
            # Logged first: whoever sees the empty map finds the reason.
            number = message.batch_id
            self._node.get_logger().info(f"batch {number}: the map of the one before is cleared")
            self._forget_map(self._batch_begin_ns)
            for frame in list(self._newest):
                if frame.stamp_ns >= self._batch_begin_ns:
                    self._fuse(frame)


def _stamps_of(message: Any) -> Sequence[int]:
    """Return the stamps of the samples that a message belongs to; announcements do not count."""
    if isinstance(message, TFMessage):
        return [nanoseconds(each.header.stamp) for each in message.transforms]
    return () if isinstance(message, SampleInfo) else (nanoseconds(message.header.stamp),)
