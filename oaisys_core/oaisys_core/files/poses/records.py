"""The poses of a file, whatever its format, and the checks that all formats share."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.geometry import T_LINK_OPTICAL, check_position, invert, transform
from oaisys_core.types import FloatArray, Pose, SensorInfo, ShortRepr

MAX_POSES = 200_000
"""Poses in a file."""

ROTATION_TOLERANCE = 1e-3
"""Largest error of an entry of R R^T: files have six digits or more."""

FIELD = "poses"
"""Name of the field in errors about a whole file."""

_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(nan|inf)", re.I)

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class PoseSelection:
    """What is said about a file of poses beside its name.

    Attributes:
        columns: Names of the columns of a CSV file without a header; None: it has one.
        topic: Topic of a bag; None: its only one with poses.
        frame: Frame whose transforms are the poses, of a topic of transforms; None: ``base_link``.
    """

    columns: tuple[str, ...] | None = None
    topic: str | None = None
    frame: str | None = None


@dataclass(frozen=True, repr=False)
class PoseTable(ShortRepr):
    """The poses of a file.

    Attributes:
        path: The file.
        positions_m: (N, 3) positions of the body in the file's world, z up.
        quats_xyzw: (N, 4) unit quaternions that rotate the body's coordinates into the world.
        places: Where each pose stands in the file, for errors.
        times_s: (N,) seconds; None if the file has no times.
        of_camera: Whether the body is the optical frame of a camera (x right, y down, z forward),
            else it is the rig's base.
    """

    path: Path
    positions_m: FloatArray
    quats_xyzw: FloatArray
    places: tuple[str, ...]
    times_s: FloatArray | None = None
    of_camera: bool = False

    @property
    def poses(self) -> list[Pose]:
        """The poses, one after the other."""
        return [
            Pose((x, y, z), (qx, qy, qz, qw))
            for (x, y, z), (qx, qy, qz, qw) in zip(
                self.positions_m.tolist(), self.quats_xyzw.tolist(), strict=True
            )
        ]

    def rows(self, kept: Sequence[int]) -> PoseTable:
        """Return the table of some poses."""
        index = list(kept)
        return replace(
            self,
            positions_m=self.positions_m[index],
            quats_xyzw=self.quats_xyzw[index],
            places=tuple(self.places[row] for row in index),
            times_s=None if self.times_s is None else self.times_s[index],
        )


def number(text: str | None, where: str, column: str) -> float:
    """Return a number of a text file.

    Raises:
        InvalidInputError: It is none; names the place, the column and the text.
    """
    found = (text or "").strip()
    if not _NUMBER.fullmatch(found):
        raise InvalidInputError(where, text, f"a number in the column {column}")
    return float(found)


def matrix_table(
    path: Path,
    T_world_camera: ArrayLike,
    places: Sequence[str],
    world: ArrayLike | None = None,
) -> PoseTable:
    """Return the table of (N, 4, 4) poses of a camera's optical frame.

    Args:
        path: The file.
        T_world_camera: The poses, as in the file.
        places: Where each stands, for errors.
        world: (4, 4) pose of the file's world in ``map``; None: they are the same.

    Raises:
        InvalidInputError: A matrix is not finite, or no rotation and shift.
    """
    from scipy.spatial.transform import Rotation

    T = np.asarray(T_world_camera, np.float64).reshape(-1, 4, 4)
    for place, each in zip(places, T, strict=True):
        R = each[:3, :3]
        if not np.isfinite(each).all():
            raise InvalidInputError(place, each[:3].tolist(), "finite numbers")
        check_position(each[:3, 3], place)
        # No element is larger than 1, and the products of far larger ones are infinite.
        is_near = np.abs(R).max() < 2 and np.abs(R @ R.T - np.eye(3)).max() <= ROTATION_TOLERANCE
        if not is_near or np.linalg.det(R) < 0:
            expected = "a rotation: columns of length 1 at right angles, not mirrored, not scaled"
            raise InvalidInputError(place, R.tolist(), expected)
        if np.abs(each[3] - (0, 0, 0, 1)).max() > 1e-9:
            raise InvalidInputError(place, each[3].tolist(), "0, 0, 0, 1 in the fourth row")
    T = T if world is None else np.asarray(world) @ T
    quats = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
    return PoseTable(path, T[:, :3, 3], quats, tuple(places), of_camera=True)


def of_rig(
    table: PoseTable, sensors: Sequence[SensorInfo] = (), camera: str | None = None
) -> PoseTable:
    """Return a table of poses of the rig's base.

    Args:
        table: Of any body.
        sensors: The rig's cameras; none: one at its base that looks along x.
        camera: Name of the one whose optical frame the poses are of; None: the first, if the file's
            format has poses of cameras, else the rig's base.

    Raises:
        InvalidInputError: There is no such camera.
    """
    from scipy.spatial.transform import Rotation

    if camera is None and not table.of_camera:
        return table
    names = {sensor.name: sensor for sensor in sensors}
    if camera is not None and camera not in names:
        raise InvalidInputError("camera", camera, one_of(names, camera))
    chosen = names[camera] if camera is not None else next(iter(sensors), None)
    mount = T_LINK_OPTICAL if chosen is None else chosen.T_base_camera
    T_camera_base = invert(mount)
    turns = Rotation.from_quat(table.quats_xyzw)
    quats = (turns * Rotation.from_matrix(T_camera_base[:3, :3])).as_quat(canonical=True)
    positions_m = table.positions_m + turns.apply(T_camera_base[:3, 3])
    return replace(table, positions_m=positions_m, quats_xyzw=quats, of_camera=False)


def without_repeats(table: PoseTable) -> PoseTable:
    """Return the rows with a new stamp, and tell of the others."""
    if table.times_s is None:
        return table
    _, first = np.unique(table.times_s, return_index=True)
    if len(first) == len(table.times_s):
        return table
    kept = set(first.tolist())
    repeated = [row for row in range(len(table.times_s)) if row not in kept]
    _LOG.warning(
        "%s: %d rows have the stamp of an earlier row, the first of them %s with %r s;"
        " the first row of each stamp counts",
        table.path,
        len(repeated),
        table.places[repeated[0]].rpartition(":")[2],
        float(table.times_s[repeated[0]]),
    )
    return table.rows(sorted(kept))


def matrices(rotation: ArrayLike, translation_m: ArrayLike) -> FloatArray:
    """Return the (4, 4) transform of nine and three numbers of a file."""
    return transform(np.asarray(rotation, np.float64).reshape(3, 3), translation_m)
