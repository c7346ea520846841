"""A buffer of transforms between frames, looked up at exact stamps."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

HISTORY = 256
"""Stamps that are kept of each moving frame."""


class FrameBuffer:
    """Frames, each with one parent, that stand still or move.

    A simulator moves its rig in jumps, so a pose between two stamps means nothing: there is no
    interpolation, and a frame that moves is known at its own stamps only.
    """

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}
        self._static: dict[str, FloatArray] = {}
        self._moving: dict[str, OrderedDict[int, FloatArray]] = {}

    def set_static(self, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Fix ``child`` to ``parent`` for all times."""
        self._parents[child] = parent
        self._static[child] = T_parent_child

    def set_at(self, stamp_ns: int, parent: str, child: str, T_parent_child: FloatArray) -> None:
        """Say where ``child`` was at ``stamp_ns``; the oldest stamps are forgotten."""
        self._parents[child] = parent
        history = self._moving.setdefault(child, OrderedDict())
        history[stamp_ns] = T_parent_child
        while len(history) > HISTORY:
            history.popitem(last=False)

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray | None:
        """Return ``T_target_source`` (4, 4) at a stamp; None where it is not known (yet).

        Raises:
            InvalidInputError: The frames lead round in a circle.
        """
        T_frame_source = np.eye(4)
        frame = source
        for _ in range(len(self._parents) + 1):
            if frame == target:
                return T_frame_source
            T_parent_frame = self._static.get(frame)
            if T_parent_frame is None:
                T_parent_frame = self._moving.get(frame, OrderedDict()).get(stamp_ns)
            if T_parent_frame is None:
                return None
            T_frame_source = T_parent_frame @ T_frame_source
            frame = self._parents[frame]
        raise InvalidInputError("frame_id", source, f"a frame that leads to {target!r}")
