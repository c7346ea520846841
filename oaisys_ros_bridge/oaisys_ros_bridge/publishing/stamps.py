"""The stamps of samples: taken from a clock, and always increasing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from builtin_interfaces.msg import Time as TimeMsg
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMsg

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.qos import CLOCK_QOS

STEADY_CLOCK = Clock(clock_type=ClockType.STEADY_TIME)
"""For timers that must go on while simulated time stands still."""

CLOCK_PERIOD_S = 0.1
"""Between two repetitions of a simulated time that stands still, for late subscribers."""
NS_PER_S = 1_000_000_000


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

    def __init__(self, node: Node, settings: Callable[[], Mapping[str, Any]]) -> None:
        self._node = node
        self._settings = settings
        self._lock = threading.Lock()
        self._last_ns = self._simulated_ns = 0
        self.simulated = bool(settings()["publish_clock"])
        if not self.simulated:
            return
        if node.get_parameter("use_sim_time").value:
            expected = "false, as publish_clock makes this node the one that tells the time"
            raise InvalidInputError("use_sim_time", True, expected)
        self._clock = node.create_publisher(ClockMsg, "/clock", CLOCK_QOS)
        self._timer = node.create_timer(CLOCK_PERIOD_S, self._publish)

    def next(self) -> TimeMsg:
        """Return the stamp of a sample."""
        if self.simulated:
            return self.advance(self._settings()["clock_step_s"])
        return self.between()

    def between(self) -> TimeMsg:
        """Return the stamp of any other message: now, or a nanosecond after the last stamp.

        Simulated time does not increase for it: samples stay at whole steps.
        """
        with self._lock:
            now_ns = 0 if self.simulated else self._node.get_clock().now().nanoseconds
            self._last_ns = max(now_ns, self._last_ns + 1)
            return _stamp(self._last_ns)

    def repeated(self) -> TimeMsg | None:
        """Return the stamp of a message that is published again: now.

        None if this node is the clock, or the clock has stood still since the last stamp: a repeat
        never reuses a stamp, and never takes the one of the next sample.
        """
        with self._lock:
            now_ns = self._node.get_clock().now().nanoseconds
            if self.simulated or now_ns <= self._last_ns:
                return None
            self._last_ns = now_ns
            return _stamp(now_ns)

    def advance(self, seconds: float) -> TimeMsg:
        """Increase simulated time, publish it, and return it."""
        with self._lock:
            self._simulated_ns += round(seconds * NS_PER_S)
            self._last_ns = max(self._simulated_ns, self._last_ns + 1)
            stamp = _stamp(self._last_ns)
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
                self._clock.publish(ClockMsg(clock=_stamp(self._last_ns)))


def _stamp(nanoseconds: int) -> TimeMsg:
    stamp: TimeMsg = Time(nanoseconds=nanoseconds).to_msg()
    return stamp


def nanoseconds(stamp: TimeMsg) -> int:
    """Return a stamp as one number."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
