"""Writing and reading poses in CSV files."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from oaisys_core.files.poses import PoseSelection, of_rig, read_pose_table
from oaisys_core.output.files import append_text, csv_text, write_text
from oaisys_core.types import Pose

POSE_COLUMNS = ("sample_id", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


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
    """Return the poses of a file of any format that `read_pose_table` knows.

    Poses of a camera become those of a body with the camera at its origin, looking along x.

    Args:
        path: The file, such as a CSV file with the columns of `POSE_COLUMNS` (``sample_id``
            optional).
        columns: Names of the columns of a CSV file; None if the first line is a header.

    Raises:
        InvalidInputError: The file cannot be read or a row is not a pose; names line and value.
    """
    selection = PoseSelection(columns=None if columns is None else tuple(columns))
    return of_rig(read_pose_table(path, selection)).poses


def _lines(rows: Sequence[Sequence[object]]) -> str:
    return csv_text(rows, line_end="\r\n")
