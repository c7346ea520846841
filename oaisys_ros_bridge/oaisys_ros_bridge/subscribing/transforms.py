"""A buffer of transforms between frames, looked up at exact stamps."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

HISTORY = 256
"""Poses that are kept of each moving frame, one after the other."""
MOST_STAMPS = 65_536
"""Stamps that are kept of each moving frame: a pose that is repeated has many."""


class _Track:
    """Where one frame was, by stamp: its parent then, and its pose in that."""

    def __init__(self) -> None:
        self._poses: OrderedDict[int, tuple[str, FloatArray]] = OrderedDict()
        self._moves = 0
        self._newest: tuple[str, FloatArray] | None = None

    def add(self, stamp_ns: int, parent: str, T_parent_child: FloatArray) -> None:
        """Take a pose in; the oldest are forgotten."""
        if stamp_ns in self._poses:
            self._poses[stamp_ns] = (parent, T_parent_child)
            return
        newest = self._newest
        if newest is None or newest[0] != parent or not np.array_equal(newest[1], T_parent_child):
            newest = self._newest = (parent, T_parent_child)
            self._moves += 1
        self._poses[stamp_ns] = newest
        while self._moves > HISTORY or len(self._poses) > MOST_STAMPS:
            _, oldest = self._poses.popitem(last=False)
            self._moves -= next(iter(self._poses.values())) is not oldest

    def at(self, stamp_ns: int) -> tuple[str, FloatArray] | None:
        """Return the parent and the pose in it at a stamp."""
        return self._poses.get(stamp_ns)


class FrameBuffer:
    """Frames, each with one parent, that stand still or move.

    A simulator moves its rig in jumps, so a pose between two stamps means nothing: there is no
    interpolation, and a frame that moves is known at its own stamps only. A bridge repeats its last
    pose under new stamps while it waits: however many these are, they push out no pose whose image
    is still to come.
    """

    def __init__(self) -> None:
        self._static: dict[str, tuple[str, FloatArray]] = {}
        self._moving: dict[str, _Track] = {}

    def set_static(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Fix ``child`` to ``parent`` for all times."""
        self._static[child] = (parent, T_parent_child)

    def set_at(self, stamp_ns: int, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Say where ``child`` was at ``stamp_ns``; the oldest poses are forgotten."""
        self._moving.setdefault(child, _Track()).add(stamp_ns, parent, T_parent_child)

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        """Return ``T_target_source`` (4, 4) at a stamp; None where it is not known (yet).

        Raises:
            InvalidInputError: The frames lead round in a circle.
        """
        T_frame_source = np.eye(4)
        frame = source
        for _ in range(len(self._static) + len(self._moving) + 1):
            if frame == target:
                return T_frame_source
            placed = self._static.get(frame)
            if placed is None and frame in self._moving:
                placed = self._moving[frame].at(stamp_ns)
            if placed is None:
                return None
            frame, T_parent_frame = placed
            T_frame_source = T_parent_frame @ T_frame_source
        raise InvalidInputError("frame_id", source, f"a frame that leads to {target!r}")
