"""Timers that go on while simulated time stands still."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

_STEADY_CLOCK = Clock(clock_type=ClockType.STEADY_TIME)


def steady_timer(
    node: Node, period_s: float, callback: Callable[[], object], group: CallbackGroup | None = None
) -> Timer:
    """Call ``callback`` every ``period_s`` seconds; in a callback group of its own, if not given.

    Time is that of the system's steady clock, whatever ``use_sim_time`` says.
    """
    group = group or MutuallyExclusiveCallbackGroup()
    return node.create_timer(period_s, callback, callback_group=group, clock=_STEADY_CLOCK)
