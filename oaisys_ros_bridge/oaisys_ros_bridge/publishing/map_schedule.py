"""When a map is made: for each view, or at a period; and why there is none."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from rclpy.node import Node


@dataclass(frozen=True)
class NewestView:
    """What the next map would be of.

    Attributes:
        number: Of the view; another one for each.
        stamp_ns: When it was taken.
        xy_m: The rig or its camera, in ``map``.
        resets: How often what maps are made of was emptied before; numbers then begin again.
    """

    number: int
    stamp_ns: int
    xy_m: tuple[float, float]
    resets: int = 0

    @property
    def key(self) -> tuple[int, int]:
        """Differs from that of any other view."""
        return self.resets, self.number


class MapSchedule:
    """Decides when the next map is due.

    Args:
        node: Logs why there is no map.
        what: Names the map in the log.
        newest_view: Returns the newest view; None: there is none.
    """

    def __init__(self, node: Node, what: str, newest_view: Callable[[], NewestView | None]) -> None:
        self._node = node
        self._what = what
        self._newest_view = newest_view
        self._published: tuple[int, int] | None = None
        self._published_s = -math.inf
        self._told = ""

    def take(self, period_s: float) -> NewestView | None:
        """Return the newest view if a map of it is due, which then counts as made.

        Args:
            period_s: Least time between two maps; 0: one for each view.
        """
        view = self._newest_view()
        now_s = time.monotonic()
        if view is None:
            return None
        if now_s < self._published_s + period_s if period_s else view.key == self._published:
            return None
        self._published, self._published_s = view.key, now_s
        return view

    def still_has(self, view: NewestView) -> bool:
        """Return whether a view is still in what maps are made of; it is not after a reset."""
        newest = self._newest_view()
        return newest is not None and newest.resets == view.resets

    def tell(self, reason: str) -> None:
        """Warn why there is no map, once for the same reason; empty: there is one."""
        if reason and reason != self._told:
            self._node.get_logger().warning(f"no {self._what}: {reason}")
        self._told = reason
