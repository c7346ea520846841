"""A buffer of transforms between frames, looked up at exact stamps."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_ros_bridge.subscribing.foreign_names import check_name

HISTORY = 256
"""Different poses in a row that are kept of each moving frame."""
MAX_STAMPS = 65_536
"""Stamps that are kept of each moving frame: a repeated pose has many."""
MAX_FRAMES = 10_000
"""Frames that are kept, fixed and moving ones; further names are refused."""


class _FrameHistory:
    """The poses of one frame by stamp, each with its parent frame."""

    def __init__(self) -> None:
        self._poses: OrderedDict[int, tuple[str, FloatArray]] = OrderedDict()
        self._moves = 0
        self._newest: tuple[str, FloatArray] | None = None

    def add(self, stamp_ns: int, parent: str, T_parent_child: FloatArray) -> None:
        """Add a pose; the oldest are removed."""
        if stamp_ns in self._poses:
            self._poses[stamp_ns] = (parent, T_parent_child)
            return
        newest = self._newest
        if newest is None or newest[0] != parent or not np.array_equal(newest[1], T_parent_child):
            newest = self._newest = (parent, T_parent_child)
            self._moves += 1
        self._poses[stamp_ns] = newest
        while self._moves > HISTORY or len(self._poses) > MAX_STAMPS:
            _, oldest = self._poses.popitem(last=False)
            self._moves -= next(iter(self._poses.values())) is not oldest

    def at(self, stamp_ns: int) -> tuple[str, FloatArray] | None:
        """Return the parent and the pose in it at a stamp."""
        return self._poses.get(stamp_ns)


class FrameBuffer:
    """Frames, each with one parent, fixed or moving.

    A simulator moves its rig in jumps, so poses are not interpolated: a moving frame is known only
    at its own stamps. The bridge repeats its last pose under new stamps; these repeats never push
    out a pose whose image is still to come.
    """

    def __init__(self) -> None:
        self._static: dict[str, tuple[str, FloatArray]] = {}
        self._moving: dict[str, _FrameHistory] = {}

    def set_static(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Set a transform that holds at all times; `InvalidInputError`: see `set_at`."""
        self._check(parent, child)
        self._static[child] = (parent, T_parent_child)

    def set_at(self, stamp_ns: int, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Set a transform that holds at ``stamp_ns``; the oldest are removed.

        Raises:
            InvalidInputError: There are too many frames, or a name is too long.
        """
        self._check(parent, child)
        self._moving.setdefault(child, _FrameHistory()).add(stamp_ns, parent, T_parent_child)

    def _check(self, parent: str, child: str) -> None:
        check_name("frame_id", parent)
        check_name("child_frame_id", child)
        known = child in self._static or child in self._moving
        if not known and len(self._static) + len(self._moving) >= MAX_FRAMES:
            raise InvalidInputError("child_frame_id", child, f"at most {MAX_FRAMES} frames")

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        """Return ``T_target_source`` (4, 4) at a stamp; None if it is not known (yet).

        Raises:
            InvalidInputError: The parents of the frames form a cycle.
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
