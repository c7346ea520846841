"""Trajectories in files: read in any format with times, written as CSV or TUM files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table, with_times
from oaisys_core.output.files import write_text
from oaisys_core.output.poses import POSE_COLUMNS
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray, SensorInfo

TRAJECTORY_COLUMNS = ("t_s", *POSE_COLUMNS[1:])
"""Columns of a CSV file; TUM files have the same numbers in the same order, without a header."""

TUM_SUFFIXES = (".tum", ".txt")


def read_trajectory(
    path: Path,
    selection: PoseSelection | None = None,
    sensors: Sequence[SensorInfo] = (),
    camera: str | None = None,
    times_file: Path | None = None,
) -> Trajectory:
    """Return the trajectory of a file of any format that `read_pose_table` knows.

    Of rows with one stamp the first counts. Inverse: `write_trajectory`.

    Args:
        path: The file.
        selection: What its name does not say.
        sensors, camera: See `of_rig`.
        times_file: Seconds of each pose, one a line, for a file that has none.

    Raises:
        InvalidInputError: The file cannot be read, a row is not a pose, times are missing or go
            back; names line and value.
    """
    table = read_pose_table(path, selection)
    if times_file is not None:
        table = with_times(table, times_file)
    if table.times_s is None:
        expected = (
            "times, which this file lacks: name a file with one number of seconds for each pose,"
            " such as KITTI's times.txt, in the key times_file"
        )
        raise InvalidInputError("trajectory", str(path), expected)
    if len(table.times_s) < 2:
        raise InvalidInputError("trajectory", str(path), "at least two rows with poses")
    for row in (np.flatnonzero(np.diff(table.times_s) < 0) + 1).tolist():
        expected = f"a time after {float(table.times_s[row - 1])!r} s"
        field = f"{table.places[row]}: trajectory.times_s.{row}"
        raise InvalidInputError(field, float(table.times_s[row]), expected)
    rig = of_rig(table, sensors, camera)
    return Trajectory(table.times_s, rig.positions_m, rig.quats_xyzw)


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write the given poses of a trajectory; reading the file gives the same trajectory.

    Raises:
        RenderError: It could not be written.
    """
    table = np.column_stack((trajectory.times_s, trajectory.positions_m, trajectory.quats_xyzw))
    write_poses(path, table)


def write_poses(path: Path, table: FloatArray) -> None:
    """Write (K, 8) rows of `TRAJECTORY_COLUMNS` to a CSV or, by its suffix, a TUM file."""
    if path.suffix in TUM_SUFFIXES:
        head, separator = "# timestamp tx ty tz qx qy qz qw", " "
    else:
        head, separator = ",".join(TRAJECTORY_COLUMNS), ","
    rows = [separator.join(map(repr, row)) for row in table.tolist()]
    write_text(path, "\n".join([head, *rows, ""]))
