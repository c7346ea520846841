"""The topics of the bridge about the simulator that it has found: its world and its samples."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

from builtin_interfaces.msg import Time
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header, String

from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.types import DriveInstant, Sample, SampleOutline, SimulatorInfo
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bridge.back_pressure import BackPressure
from oaisys_ros_bridge.conversions import NS_PER_S, stamp_from_nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.frame_history import FrameHistory
from oaisys_ros_bridge.publishing.sample_publisher import (
    Publication,
    SamplePublisher,
    batch_info_msg,
)
from oaisys_ros_bridge.qos import CLOCK_QOS, LATCHED_QOS

CLOCK_PERIOD_S = 0.1
"""Between two repetitions of a simulated time that stands still, for late subscribers."""


class WorldTopics:
    """Topics that exist while the bridge is configured; safe to use from any thread.

    Args:
        node: Owner of the publishers.
        settings: Returns the bridge's parameters.
        back_pressure: Of our mapper and recorders; while one is behind, no transform is repeated.
    """

    def __init__(self, node: Node, settings: Settings, back_pressure: BackPressure) -> None:
        self._node = node
        self._settings = settings
        self._back_pressure = back_pressure
        self._lock = threading.RLock()
        self._samples: SamplePublisher | None = None
        self._stamps: Stamps | None = None
        self._repeater: Timer | None = None
        self._announced: tuple[str, int, int] | None = None
        self._numbers = count(1)
        self._batch = node.create_publisher(SampleInfo, "~/batch", LATCHED_QOS)
        self._configuration = node.create_publisher(String, "~/configuration", LATCHED_QOS)
        self._configured = ""

    def offer(self, info: SimulatorInfo) -> None:
        """Create the topics of a simulator, or keep them if its sensors are the same."""
        with self._lock:
            self._stamps = self._stamps or Stamps(self._node, self._settings)
            if self._samples is not None and self._samples.fits(info):
                self._samples.update(info)
                return
            if self._samples is not None:
                self._samples.destroy()
            self._samples = SamplePublisher(
                self._node, info, self._settings, self._numbers, now=self.now
            )
            if self._repeater is None and (rate_hz := self._settings()["tf_rate"]):
                group = MutuallyExclusiveCallbackGroup()
                self._repeater = self._node.create_timer(
                    1 / rate_hz, self._repeat_transforms, callback_group=group
                )

    def update(self, info: SimulatorInfo) -> None:
        """Follow a change of the simulator, if its topics are offered."""
        with self._lock:
            if self._samples is not None:
                self.offer(info)

    def publish_configuration(self, config_json: str) -> None:
        """Publish once the configuration of the simulator, by which a bag can be rendered again."""
        with self._lock:
            if config_json and config_json != self._configured:
                self._configured = config_json
                self._configuration.publish(String(data=config_json))

    def announce(self, info: SimulatorInfo) -> None:
        """Publish once that there is another world, and create the topics that it needs."""
        batch = (info.config_sha256, info.seed, info.batch_id)
        with self._lock:
            if self._stamps is None or info.batch_id == 0 or batch == self._announced:
                return
            self._announced = batch
            self.offer(info)
            header = Header(stamp=self._stamps.between(), frame_id=self._settings()["map_frame"])
            self._batch.publish(batch_info_msg(info, header))

    def begin(self, outline: SampleOutline) -> Publication:
        """Begin to publish a sample.

        Raises:
            NotReadyError: There are no topics any more.
        """
        with self._lock:
            if self._samples is None or self._stamps is None:
                raise NotReadyError("the bridge is not configured any more")
            return self._samples.begin(outline, self._stamps.next())

    @contextmanager
    def driving(self, start_ns: int) -> Iterator[DriveTopics]:
        """Publish a drive inside this block, at whose simulated time stamps then are.

        Args:
            start_ns: Simulated time of the drive's start.

        Raises:
            NotReadyError: There are no topics any more.
        """
        with self._lock:
            if self._samples is None or self._stamps is None:
                raise NotReadyError("the bridge is not configured any more")
            samples, stamps = self._samples, self._stamps
        begin_ns = stamps.begin_drive()
        try:
            yield DriveTopics(samples, stamps, begin_ns, start_ns)
        finally:
            stamps.end_drive()

    def now(self) -> Time:
        """Return the bridge's own time: with ``publish_clock`` the simulated one, 0 at first."""
        with self._lock:
            if self._stamps is not None:
                return self._stamps.now()
        if self.has_clock:
            return Time()
        now: Time = self._node.get_clock().now().to_msg()
        return now

    @property
    def frames(self) -> FrameHistory:
        """Where the frames of the published transforms are.

        Raises:
            NotReadyError: There are no topics.
        """
        with self._lock:
            if self._samples is None:
                raise NotReadyError("the bridge is not configured yet")
            return self._samples.rig.frames

    @property
    def has_clock(self) -> bool:
        """Whether the bridge publishes a simulated time."""
        return bool(self._settings()["publish_clock"])

    def restart_clock(self) -> None:
        """Reset simulated time, if there is one."""
        with self._lock:
            if self._stamps is not None:
                self._stamps.reset()

    def withdraw(self) -> None:
        """Remove all topics."""
        with self._lock:
            if self._samples is not None:
                self._samples.destroy()
            if self._stamps is not None:
                self._stamps.close()
            if self._repeater is not None:
                self._node.destroy_timer(self._repeater)
            self._samples = self._stamps = self._announced = self._repeater = None

    def _repeat_transforms(self) -> None:
        """Publish the last transforms again, unless one of our readers is behind.

        The bridge does not wait for repeats, so they could push a sample's transforms out of that
        reader's queue.
        """
        if self._back_pressure.readers_are_behind:
            return
        with self._lock:
            if self._samples is None or self._stamps is None:
                return
            stamp = self._stamps.repeat_stamp()
            if stamp is not None:
                self._samples.rig.repeat(stamp)


class DriveTopics:
    """Publishes one drive.

    Args:
        samples: The topics.
        stamps: Makes the stamps.
        begin_ns: Stamp of the drive's start.
        start_ns: Simulated time of the drive's start.
    """

    def __init__(
        self, samples: SamplePublisher, stamps: Stamps, begin_ns: int, start_ns: int
    ) -> None:
        self._samples = samples
        self._stamps = stamps
        self._begin_ns, self._start_ns = begin_ns, start_ns
        self._before = Counter(samples.publishers.counts)

    @property
    def begin(self) -> Time:
        """Stamp of the drive's start."""
        return stamp_from_nanoseconds(self._begin_ns)

    @property
    def counts(self) -> dict[str, int]:
        """How many messages of the drive were published, by the topic's full name."""
        return dict(self._samples.publishers.counts - self._before)

    def stamp(self, instant: DriveInstant) -> Time:
        """Let simulated time be that of an instant, and return it."""
        return self._stamps.set(self._begin_ns + instant.time_ns - self._start_ns)

    def publish(self, instant: DriveInstant, stamp: Time) -> None:
        """Publish what a drive brings at one time at which nothing was rendered."""
        self._samples.publish_instant(instant, stamp)

    def begin_sample(self, sample: Sample, instant: DriveInstant, stamp: Time) -> Publication:
        """Begin to publish what was rendered at one time, and all else at that time."""
        return self._samples.begin(sample.outline, stamp, instant)


class Stamps:
    """Gives each sample a stamp that is later than all before.

    * By default, time is that of the node's clock: the system's, or with ``use_sim_time`` that of
      another node's ``/clock``. A sample is stamped when its first message is published. While the
      clock stands still, stamps increase by a nanosecond.
    * With ``publish_clock`` this node is the clock. Simulated time starts at 0, increases by
      ``clock_step_s`` with each sample, stands still in between, and is published on ``/clock``
      before the first message that carries it. So a run has the same stamps on every machine. Time
      never goes back, not even at a new batch, until `reset`.

    Args:
        node: Owner of the clock.
        settings: Returns the values of ``publish_clock`` (read now) and ``clock_step_s``.

    Raises:
        InvalidInputError: The node would both be the clock and follow one.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node = node
        self._settings = settings
        self._lock = threading.RLock()
        self._last_ns = self._simulated_ns = 0
        self._is_driving = False
        self.simulated = bool(settings()["publish_clock"])
        if not self.simulated:
            return
        if node.get_parameter("use_sim_time").value:
            expected = "false, as publish_clock makes this node the one that tells the time"
            raise InvalidInputError("use_sim_time", True, expected)
        self._clock = node.create_publisher(Clock, "/clock", CLOCK_QOS)
        self._timer = node.create_timer(CLOCK_PERIOD_S, self._publish)

    def now(self) -> Time:
        """Return the time of a message that belongs to no sample; it may be told several times."""
        if not self.simulated:
            now: Time = self._node.get_clock().now().to_msg()
            return now
        with self._lock:
            return stamp_from_nanoseconds(self._last_ns)

    def next(self) -> Time:
        """Return the stamp of a sample."""
        if self.simulated:
            return self.advance(self._settings()["clock_step_s"])
        return self.between()

    def between(self) -> Time:
        """Return the stamp of any other message: now, or a nanosecond after the last stamp.

        Simulated time does not increase for it: samples stay at whole steps.
        """
        with self._lock:
            has_own_time = self.simulated or self._is_driving
            now_ns = 0 if has_own_time else self._node.get_clock().now().nanoseconds
            self._last_ns = max(now_ns, self._last_ns + 1)
            return stamp_from_nanoseconds(self._last_ns)

    def repeat_stamp(self) -> Time | None:
        """Return the stamp of a message that is published again: now.

        None if this node is the clock, during a drive, or if the clock has stood still since the
        last stamp: a repeat never reuses a stamp, and never takes the one of the next sample.
        """
        with self._lock:
            now_ns = self._node.get_clock().now().nanoseconds
            if self.simulated or self._is_driving or now_ns <= self._last_ns:
                return None
            self._last_ns = now_ns
            return stamp_from_nanoseconds(now_ns)

    def advance(self, seconds: float) -> Time:
        """Increase simulated time, publish it, and return it."""
        with self._lock:
            return self.set(self._simulated_ns + round(seconds * NS_PER_S))

    def begin_drive(self) -> int:
        """Return the stamp, in nanoseconds, of the start of a drive, whose times `set` is given.

        With a simulated time it is one step later than the last sample, else now.
        """
        step_ns = round(self._settings()["clock_step_s"] * NS_PER_S)
        with self._lock:
            now_ns = int(self._node.get_clock().now().nanoseconds)
            begin_ns = self._simulated_ns + step_ns if self.simulated else now_ns
            self._is_driving = True
            return max(begin_ns, self._last_ns + 1)

    def end_drive(self) -> None:
        """Let stamps be those of the node's clock again, unless this node is the clock."""
        with self._lock:
            self._is_driving = False

    def set(self, stamp_ns: int) -> Time:
        """Set simulated time, publish it if this node is the clock, and return it."""
        with self._lock:
            self._last_ns = max(stamp_ns, self._last_ns + 1)
            self._simulated_ns = stamp_ns
            stamp = stamp_from_nanoseconds(self._last_ns)
            self._publish()
            return stamp

    def reset(self) -> None:
        """Set simulated time back to 0."""
        if not self.simulated:
            return
        with self._lock:
            self._last_ns = self._simulated_ns = 0
        self._publish()

    def close(self) -> None:
        """Remove the clock from the node."""
        if self.simulated:
            self._node.destroy_timer(self._timer)
            self._node.destroy_publisher(self._clock)
            self.simulated = False

    def _publish(self) -> None:
        if self.simulated:
            with self._lock:
                self._clock.publish(Clock(clock=stamp_from_nanoseconds(self._last_ns)))
