"""The pose of one frame from recorded transforms between many, as tf2 looks it up."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.geometry import xyz
from oaisys_core.types import FloatArray

MAX_TRANSFORMS = 2_000_000
"""Transforms of a bag that are kept while the way between two frames is not yet known."""

MAP_FRAME = "map"

_LOG = logging.getLogger(__name__)


class StampedPose(NamedTuple):
    """A pose in a message.

    Attributes:
        stamp_ns: Its stamp; None if it has none.
        position_m, quat_xyzw: Of a body in the frame of the message.
        place: Where it is in the bag, for errors.
    """

    stamp_ns: int | None
    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    place: str


@dataclass
class TransformTree:
    """Transforms by child frame.

    Attributes:
        parents: The parent of each frame.
        moving: Poses of a frame in its parent, as received.
        fixed: The last pose of a frame that does not move in its parent.
    """

    parents: dict[str, str] = field(default_factory=dict)
    moving: dict[str, list[StampedPose]] = field(default_factory=dict)
    fixed: dict[str, StampedPose] = field(default_factory=dict)
    _count: int = 0

    def add(self, parent: str, child: str, pose: StampedPose, *, is_fixed: bool) -> None:
        """Add a transform.

        Raises:
            InvalidInputError: Another parent was recorded for the child, or there are too many.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if self.parents.setdefault(child, parent) != parent:
            expected = f"one parent of {child}, as before: {self.parents[child]}"
            raise InvalidInputError(pose.place, parent, expected)
        self._count += 1
        if self._count > MAX_TRANSFORMS:
            raise InvalidInputError(pose.place, self._count, f"at most {MAX_TRANSFORMS} transforms")
        if is_fixed:
            self.fixed[child] = pose
        else:
            self.moving.setdefault(child, []).append(pose)

    def chain(self, frame: str) -> list[str]:
        """Return the frames from ``frame`` up to, without it, ``map`` or the topmost frame.

        Raises:
            InvalidInputError: There is no such frame, or the frames go in a circle.
        """
        frame = frame.lstrip("/")
        if frame not in self.parents:
            raise InvalidInputError("frame", frame, one_of(self.parents, frame))
        found: list[str] = []
        while frame in self.parents and frame != MAP_FRAME:
            if frame in found:
                raise InvalidInputError("frame", [*found, frame], "frames that are no circle")
            found.append(frame)
            frame = self.parents[frame]
        return found


def poses_of_frame(tree: TransformTree, frame: str, path: Path) -> list[StampedPose]:
    """Return the poses of a frame in ``map``, or in the topmost frame, in the order of stamps.

    Where several frames on the way move, poses are given at the stamps of the one next to
    ``frame``; the others are interpolated as by tf2, and not extrapolated.

    Raises:
        InvalidInputError: The frame is unknown or does not move, or no stamp is known to all.
    """
    chain = tree.chain(frame)
    moving = [each for each in chain if each in tree.moving]
    if not moving:
        expected = f"a frame that moves: {', '.join(sorted(tree.moving)) or 'none does'}"
        raise InvalidInputError("frame", frame, expected)
    tracks = {each: _in_order(tree.moving[each], each, path) for each in moving}
    first, *others = moving
    stamps = np.array([pose.stamp_ns for pose in tracks[first]], np.int64)
    known = np.ones(len(stamps), np.bool_)
    for each in others:
        begin, end = tracks[each][0].stamp_ns or 0, tracks[each][-1].stamp_ns or 0
        known &= (stamps >= begin) & (stamps <= end)
    if not known.any():
        expected = f"stamps at which all of {', '.join(moving)} are known"
        raise InvalidInputError("frame", frame, expected)
    if not known.all():
        _LOG.warning(
            "%s: %d poses of %s are left out: %s are not known at their stamps",
            path,
            int((~known).sum()),
            frame,
            ", ".join(others),
        )
    unique_frame({tree.parents[chain[-1]]}, f"{path}: {frame}")
    places = [pose.place for pose, used in zip(tracks[first], known, strict=True) if used]
    return _compose(tree, chain, tracks, stamps[known], places)


def _in_order(poses: Sequence[StampedPose], frame: str, path: Path) -> list[StampedPose]:
    """Return the first pose of each stamp in the order of stamps, and tell of the others."""
    by_stamp: dict[int, StampedPose] = {}
    for pose in poses:
        by_stamp.setdefault(pose.stamp_ns or 0, pose)
    if len(by_stamp) < len(poses):
        _LOG.warning(
            "%s: %d transforms of %s have the stamp of an earlier one; the first counts",
            path,
            len(poses) - len(by_stamp),
            frame,
        )
    return [by_stamp[stamp] for stamp in sorted(by_stamp)]


def _compose(
    tree: TransformTree,
    chain: Sequence[str],
    tracks: dict[str, list[StampedPose]],
    stamps: NDArray[np.int64],
    places: Sequence[str],
) -> list[StampedPose]:
    """Return the products of all transforms from the topmost frame down, at some stamps."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.identity(len(stamps))
    shifts = np.zeros((len(stamps), 3))
    for frame in reversed(chain):
        poses = tracks.get(frame)
        shift, turn = (
            _interpolated([tree.fixed[frame]] * 2, np.array([0, 1]), np.zeros(len(stamps)))
            if poses is None
            else _interpolated(poses, np.array([p.stamp_ns for p in poses], np.int64), stamps)
        )
        shifts = shifts + turns.apply(shift)
        turns = turns * Rotation.from_quat(turn)
    quats = turns.as_quat(canonical=True).tolist()
    return [
        StampedPose(int(stamp), xyz(shift), (x, y, z, w), place)
        for stamp, shift, (x, y, z, w), place in zip(stamps, shifts, quats, places, strict=True)
    ]


def _interpolated(
    poses: Sequence[StampedPose], at: NDArray[np.int64], stamps: NDArray[np.generic]
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3) positions and (N, 4) quaternions, linear and spherical between two poses."""
    from scipy.spatial.transform import Rotation, Slerp

    positions = np.array([pose.position_m for pose in poses])
    quats = np.array([pose.quat_xyzw for pose in poses])
    row = np.searchsorted(at, stamps)
    if (at[np.minimum(row, len(at) - 1)] == stamps).all():
        return positions[row], quats[row]
    # Nanoseconds since 1970 have more digits than a float.
    knots, wanted = (at - at[0]).astype(np.float64), (stamps - at[0]).astype(np.float64)
    shifts = np.column_stack([np.interp(wanted, knots, positions[:, axis]) for axis in range(3)])
    return shifts, Slerp(knots, Rotation.from_quat(quats))(wanted).as_quat()


def unique_frame(frames: Collection[str], what: str) -> None:
    """Raise if poses are in several frames, and tell that another one is taken as ``map``.

    Raises:
        InvalidInputError: There are several.
    """
    names = sorted({frame.lstrip("/") for frame in frames})
    if len(names) > 1:
        raise InvalidInputError(what, names, "poses in one frame")
    if names and names[0] not in ("", MAP_FRAME):
        _LOG.warning("%s: poses are in %s, which is taken as map", what, names[0])
