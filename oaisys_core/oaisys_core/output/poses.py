"""Writing and reading poses in CSV files."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import read_numbered_csv
from oaisys_core.geometry import check_pose
from oaisys_core.output.files import append_text, csv_text, write_text
from oaisys_core.types import Pose

POSE_COLUMNS = ("sample_id", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


MAX_POSES = 200_000
"""Rows of a file of poses, waypoints or a trajectory."""


def append_pose(path: Path, sample_id: int, pose: Pose) -> None:
    """Append the row of a sample to a file, after a header in a new file.

    Raises:
        RenderError: It could not be written; the file is unchanged.
    """
    rows: list[Sequence[object]] = [] if path.exists() else [POSE_COLUMNS]
    append_text(path, _lines([*rows, (sample_id, *pose.position_m, *pose.quat_xyzw)]))


def drop_poses_after(path: Path, sample_id: int) -> None:
    """Remove the rows of later samples from a file that `append_pose` wrote."""
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = list(csv.reader(file))
    write_text(path, _lines([head, *(row for row in rows if int(row[0]) <= sample_id)]))


def read_poses(path: Path, columns: Sequence[str] | None = None) -> list[Pose]:
    """Return the poses of a CSV file with the columns of `POSE_COLUMNS` (``sample_id`` optional).

    Args:
        path: The file.
        columns: Names of the columns; None if the first line is a header.

    Raises:
        InvalidInputError: The file cannot be read or a row is not a pose; names line and value.
    """
    try:
        rows = read_numbered_csv(path, MAX_POSES, columns)
    except (OSError, ValueError) as error:
        raise InvalidInputError("poses", str(path), f"a readable CSV file ({error})") from error
    poses = []
    for line, row in rows:
        try:
            numbers = [float(row[column]) for column in POSE_COLUMNS[1:]]
        except (KeyError, TypeError, ValueError) as error:
            expected = f"numbers in the columns {', '.join(POSE_COLUMNS[1:])}"
            raise InvalidInputError(f"{path}:{line}", dict(row), expected) from error
        poses.append(check_pose(numbers[:3], numbers[3:], f"{path}:{line}"))
    if not poses:
        raise InvalidInputError("poses", str(path), "at least one row below the header")
    return poses


def _lines(rows: Sequence[Sequence[object]]) -> str:
    return csv_text(rows, line_end="\r\n")
