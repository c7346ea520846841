"""Trajectories in files: CSV with times, EuRoC's CSV, and the text format of the TUM benchmark."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import MAX_ROW_BYTES, read_numbered_csv, read_text
from oaisys_core.geometry import check_pose
from oaisys_core.output.files import write_text
from oaisys_core.output.poses import MAX_POSES, POSE_COLUMNS
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray

TRAJECTORY_COLUMNS = ("t_s", *POSE_COLUMNS[1:])
"""Columns of a CSV file; TUM files have the same numbers in the same order, without a header."""

TUM_SUFFIXES = (".tum", ".txt")

BAG_CONVERTERS = {
    ".bag": "a bag of ROS 1: evo_traj bag FILE TOPIC --save_as_tum",
    ".db3": "an SQLite bag of ROS 2: evo_traj bag2 FOLDER TOPIC --save_as_tum",
    ".mcap": "an MCAP bag: evo_traj mcap FILE TOPIC --save_as_tum",
}
"""What bags are, by suffix, and what converts them to a file that is read."""

KITTI_NUMBERS = 12
"""Numbers in a row of a file of KITTI, the upper rows of a 4 x 4 matrix."""

_LOG = logging.getLogger(__name__)


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory of a CSV file, or of a TUM file (``.tum``, ``.txt``).

    A CSV file may have further columns, or be EuRoC's: nanoseconds, position, w first. Of rows
    with one stamp that follow each other the first counts. Inverse: `write_trajectory`.

    Raises:
        InvalidInputError: The file cannot be read, or a row is not a pose; names line and value.
    """
    suffix = path.suffix.lower()
    if suffix in BAG_CONVERTERS:
        expected = f"a CSV or TUM file. It is {BAG_CONVERTERS[suffix]} converts it"
        raise InvalidInputError("trajectory", str(path), expected)
    try:
        lines = _tum_lines(path) if suffix in TUM_SUFFIXES else _csv_lines(path)
    except (OSError, ValueError) as error:
        raise InvalidInputError("trajectory", str(path), f"a readable file ({error})") from error
    rows = _without_repeats(path, [_row(f"{path}:{number}", texts) for number, texts in lines])
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


def _without_repeats(path: Path, rows: list[list[float]]) -> list[list[float]]:
    """Return the rows whose stamp is not that of the row before, and tell of the others."""
    kept = [row for i, row in enumerate(rows) if i == 0 or row[0] != rows[i - 1][0]]
    if len(kept) < len(rows):
        _LOG.warning(
            "%s: %d rows have the stamp of the row before; the first row of each stamp counts",
            path,
            len(rows) - len(kept),
        )
    return kept


def _csv_lines(path: Path) -> list[tuple[int, list[str | None]]]:
    text = read_text(path, MAX_POSES * MAX_ROW_BYTES).removeprefix("\ufeff")
    if text.startswith("#timestamp"):
        return _euroc_lines(path, text)
    return [
        (number, [row.get(column) for column in TRAJECTORY_COLUMNS])
        for number, row in read_numbered_csv(path, MAX_POSES)
    ]


def _euroc_lines(path: Path, text: str) -> list[tuple[int, list[str | None]]]:
    """Return the rows of a ground truth of EuRoC in the order of `TRAJECTORY_COLUMNS`.

    Raises:
        InvalidInputError: The columns are not those of the standard.
    """
    head, *rows = text.splitlines()
    names = [name.split("[")[0].strip() for name in head.split(",")]
    if [name.rpartition("_")[2] for name in names[1:8]] != ["x", "y", "z", "w", "x", "y", "z"]:
        expected = "EuRoC's columns: #timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z"
        raise InvalidInputError(f"{path}:1", head, expected)
    lines: list[tuple[int, list[str | None]]] = []
    for number, line in enumerate(rows, start=2):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        stamp, x, y, z, qw, qx, qy, qz = ([s.strip() for s in line.split(",")] + [""] * 8)[:8]
        # Integers divided once are rounded once.
        time_s = repr(int(stamp) / 10**9) if stamp.isdecimal() else f"{stamp} (nanoseconds)"
        lines.append((number, [time_s, x, y, z, qx, qy, qz, qw]))
    return lines


def _tum_lines(path: Path) -> list[tuple[int, list[str | None]]]:
    lines: list[tuple[int, list[str | None]]] = []
    text = read_text(path, MAX_POSES * MAX_ROW_BYTES).removeprefix("\ufeff")
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
    if len(texts) == KITTI_NUMBERS:
        expected = "times, which KITTI's matrices lack: join times.txt to a TUM file"
        raise InvalidInputError(where, list(texts), expected)
    if len(texts) != len(TRAJECTORY_COLUMNS):
        expected = f"the {len(TRAJECTORY_COLUMNS)} numbers {', '.join(TRAJECTORY_COLUMNS)}"
        raise InvalidInputError(where, list(texts), expected)
    numbers = []
    for column, text in zip(TRAJECTORY_COLUMNS, texts, strict=False):
        try:
            numbers.append(float(text or ""))
        except ValueError as error:
            expected = f"a number in the column {column}"
            raise InvalidInputError(where, text, expected) from error
    check_pose(numbers[1:4], numbers[4:], where)
    return numbers
