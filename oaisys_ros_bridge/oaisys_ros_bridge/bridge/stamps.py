"""Stamps of the bridge's messages: the time of its node, or a simulated one that it publishes."""

from __future__ import annotations

import threading

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.conversions import NS_PER_S, stamp_from_nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import CLOCK_QOS

CLOCK_PERIOD_S = 0.1
"""Between two repetitions of a simulated time that stands still, for late subscribers."""


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

    @property
    def is_driving(self) -> bool:
        """Whether stamps are those of a drive."""
        return self._is_driving

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

        Simulated time increases for it by no more: samples stay at whole steps.
        """
        with self._lock:
            has_own_time = self.simulated or self._is_driving
            now_ns = 0 if has_own_time else self._node.get_clock().now().nanoseconds
            self._last_ns = max(now_ns, self._last_ns + 1)
            self._publish()
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
