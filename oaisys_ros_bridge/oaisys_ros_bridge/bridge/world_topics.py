"""The topics of the bridge about the simulator that it has found: its world and its samples."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from builtin_interfaces.msg import Time
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.timer import Timer
from std_msgs.msg import Header, String

from oaisys_core.errors import NotReadyError
from oaisys_core.types import DriveInstant, Sample, SampleOutline, SimulatorInfo
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import GetNewestSample
from oaisys_ros_bridge.bridge.back_pressure import BackPressure
from oaisys_ros_bridge.bridge.stamps import Stamps
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.frame_history import FrameHistory
from oaisys_ros_bridge.publishing.sample_info import Announcements, batch_info_msg
from oaisys_ros_bridge.publishing.sample_publisher import Publication, SamplePublisher
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.timers import steady_timer


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
        self._announcements = Announcements()
        self._is_rendering = False
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
                self._node, info, self._settings, self._announcements, now=self.now
            )
            if self._repeater is None and (rate_hz := self._settings()["tf_rate"]):
                group = MutuallyExclusiveCallbackGroup()
                self._repeater = steady_timer(self._node, 1 / rate_hz, self._repeat_motion, group)

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
            self._announcements.begin_batch(header.stamp)
            self._batch.publish(batch_info_msg(info, header))
            if self._samples is not None and info.rig_pose is not None:
                values = self._settings()
                drifts = any((values["faults.drift_m"], values["faults.drift_rad"]))
                self._samples.rig.publish_start(
                    info.rig_pose, self._stamps.between(), drifts=drifts or info.odometry_drifts
                )

    @property
    def newest_sample(self) -> GetNewestSample.Response:
        """The sample and the world that were announced last."""
        return self._announcements.newest

    @contextmanager
    def rendering(self) -> Iterator[None]:
        """Repeat no odometry inside this block, unless a subscriber is new.

        Subscribers that wait for all messages of a sample have room for a few stamps only.
        """
        self._is_rendering = True
        try:
            yield
        finally:
            self._is_rendering = False

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

    def _repeat_motion(self) -> None:
        """Publish again where the rig is, unless one of our readers is behind.

        The bridge does not wait for repeats, so they could push a sample's transforms out of that
        reader's queue. While time stands still, new subscribers alone are a reason to repeat.
        """
        if self._back_pressure.readers_are_behind:
            return
        with self._lock:
            if self._samples is None or self._stamps is None or self._stamps.is_driving:
                return
            rig = self._samples.rig
            is_new = rig.has_new_subscribers()
            stamp = self._stamps.repeat_stamp()
            if stamp is None and is_new:
                stamp = self._stamps.between()
            if stamp is not None:
                rig.repeat(stamp, with_odometry=is_new or not self._is_rendering)


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
