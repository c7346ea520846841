"""Where the frames that the bridge publishes are, for poses that come in one of them."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.geometry import pose_from_matrix, pose_to_matrix
from oaisys_core.types import FloatArray, Pose
from oaisys_ros_bridge.conversions import nanoseconds, transform_from_msg

LENGTH = 10_000
"""Poses of the rig that are kept: the last 10 seconds of a drive with a thousand a second."""


class _RigPlace(NamedTuple):
    stamp_ns: int
    T_map_odom: FloatArray
    T_map_base: FloatArray


class FrameHistory:
    """The published transforms since the first sample; safe to use from any thread.

    The rig stands still between two samples, so a transform holds until the next one.

    Args:
        map_frame: Frame of the world.
        base_frame: Frame of the rig.
        odom_frame: Frame of odometry; it is the world's where nothing drifts.
    """

    def __init__(self, map_frame: str, base_frame: str, odom_frame: str) -> None:
        self._map_frame = map_frame
        self._base_frame = base_frame
        self._odom_frame = odom_frame
        self._lock = threading.Lock()
        self._places: list[_RigPlace] = []
        self._mounts: dict[str, FloatArray] = {}

    @property
    def names(self) -> list[str]:
        """The frames in which poses may come."""
        return [self._map_frame, self._odom_frame, self._base_frame, *self._mounts]

    def is_map(self, frame: str) -> bool:
        """Return whether a pose in this frame is one in the world's; the empty name stands for it.

        A planner may say ``map`` whatever the frame's name is.
        """
        return frame in ("", "map", self._map_frame)

    def set_mounts(self, mounts: Iterable[TransformStamped]) -> None:
        """Set the frames that are fixed to the rig, each after its parent."""
        T_base_frame = {self._base_frame: np.eye(4)}
        for mount in mounts:
            T_base_parent = T_base_frame[mount.header.frame_id]
            T_base_frame[mount.child_frame_id] = T_base_parent @ transform_from_msg(mount)
        del T_base_frame[self._base_frame]
        self._mounts = T_base_frame

    def add(self, stamp_ns: int, T_map_odom: FloatArray, T_map_base: FloatArray) -> None:
        """Add where the rig is from a stamp on; the oldest place is removed."""
        with self._lock:
            if self._places and stamp_ns < self._places[-1].stamp_ns:
                self._places.clear()  # simulated time has been set back
            self._places.append(_RigPlace(stamp_ns, T_map_odom, T_map_base))
            if len(self._places) > 2 * LENGTH:
                del self._places[:-LENGTH]

    def transform_to_map(self, header: Header, field: str) -> FloatArray:
        """Return the transform (4, 4) from a header's frame to the world's at its stamp.

        Args:
            header: A stamp of 0 means now.
            field: The header's name in errors.

        Raises:
            InvalidInputError: The frame is none of `names`, or its place at that time is unknown.
        """
        frame = header.frame_id
        if self.is_map(frame):
            return np.eye(4)
        if frame not in self.names:
            expected = f"empty or {one_of(self.names, frame)}"
            raise InvalidInputError(f"{field}.frame_id", frame, expected)
        place = self._place_at(nanoseconds(header.stamp), frame, field)
        if frame == self._odom_frame:
            return place.T_map_odom
        return place.T_map_base @ self._mounts.get(frame, np.eye(4))

    def pose_in_map(self, pose: Pose, header: Header, field: str) -> Pose:
        """Return in the world's frame the pose that comes in a header's; see `transform_to_map`."""
        if self.is_map(header.frame_id):
            return pose  # bit for bit
        return pose_from_matrix(self.transform_to_map(header, field) @ pose_to_matrix(pose))

    def _place_at(self, stamp_ns: int, frame: str, field: str) -> _RigPlace:
        with self._lock:
            places = self._places
            if not places:
                if frame == self._odom_frame:
                    return _RigPlace(0, np.eye(4), np.eye(4))  # they coincide at the start
                expected = f"{self._map_frame!r}: the rig's place is known from the first view on"
                raise InvalidInputError(f"{field}.frame_id", frame, expected)
            if not stamp_ns:
                return places[-1]
            index = bisect_right(places, stamp_ns, key=lambda place: place.stamp_ns)
            if index == 0:
                known_s = places[0].stamp_ns * 1e-9
                expected = f"0 for now, or at least {known_s:.9f} s, since when {frame!r} is known"
                received = f"{stamp_ns * 1e-9:.9f} s"
                raise InvalidInputError(f"{field}.stamp", received, expected)
            return places[index - 1]
