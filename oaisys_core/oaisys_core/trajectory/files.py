"""Trajectories in files: CSV with times, and the text format of the TUM RGB-D benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import MAX_ROW_BYTES, read_csv, read_text
from oaisys_core.geometry import check_pose
from oaisys_core.output.files import write_text
from oaisys_core.output.poses import MAX_POSES, POSE_COLUMNS
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray

TRAJECTORY_COLUMNS = ("t_s", *POSE_COLUMNS[1:])
"""Columns of a CSV file; TUM files have the same numbers in the same order, without a header."""

TUM_SUFFIXES = (".tum", ".txt")


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory of a CSV file, or of a TUM file (``.tum``, ``.txt``).

    A CSV file may have further columns. Inverse: `write_trajectory`.

    Raises:
        InvalidInputError: The file cannot be read, or a row is not a pose; names line and value.
    """
    try:
        lines = _tum_lines(path) if path.suffix in TUM_SUFFIXES else _csv_lines(path)
    except (OSError, ValueError) as error:
        raise InvalidInputError("trajectory", str(path), f"a readable file ({error})") from error
    rows = [_row(f"{path}:{number}", texts) for number, texts in lines]
    if len(rows) < 2:
        raise InvalidInputError("trajectory", str(path), "at least two rows with poses")
    table = np.array(rows)
    return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:])


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


def _csv_lines(path: Path) -> list[tuple[int, list[str | None]]]:
    rows = read_csv(path, MAX_POSES)
    return [
        (number, [row.get(column) for column in TRAJECTORY_COLUMNS])
        for number, row in enumerate(rows, start=2)
    ]


def _tum_lines(path: Path) -> list[tuple[int, list[str | None]]]:
    lines: list[tuple[int, list[str | None]]] = []
    text = read_text(path, MAX_POSES * MAX_ROW_BYTES)
    for number, line in enumerate(text.splitlines(), start=1):
        texts = line.partition("#")[0].replace(",", " ").split()
        if texts:
            lines.append((number, list(texts)))
    return lines


def _row(where: str, texts: Sequence[str | None]) -> list[float]:
    """Return the eight numbers of a row.

    Raises:
        InvalidInputError: They are no time and pose.
    """
    try:
        numbers = [float(text or "") for text in texts]
    except ValueError:
        numbers = []
    if len(numbers) != len(TRAJECTORY_COLUMNS):
        expected = f"the {len(TRAJECTORY_COLUMNS)} numbers {', '.join(TRAJECTORY_COLUMNS)}"
        raise InvalidInputError(where, list(texts), expected)
    check_pose(numbers[1:4], numbers[4:], where)
    return numbers
