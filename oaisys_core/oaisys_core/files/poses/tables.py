"""Poses in rows of numbers: CSV with named columns, EuRoC, TUM and KITTI."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.csv_tables import parse_numbered_csv
from oaisys_core.files.numbers import whole_of
from oaisys_core.files.poses.records import FIELD, MAX_POSES, PoseTable, matrix_table, number
from oaisys_core.geometry import T_LINK_OPTICAL, check_pose

POSE_NUMBERS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
"""Columns of a pose in a CSV file."""

TIME = "t_s"
"""Column of the time in a CSV file."""

TUM_NUMBERS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")

KITTI_NUMBERS = tuple(f"{name}{column}" for name in ("row 1, ", "row 2, ", "row 3, ") for column in
                      ("1", "2", "3", "4"))  # fmt: skip
"""Entries of the upper rows of a 4 x 4 matrix."""

EUROC_AXES = ["x", "y", "z", "w", "x", "y", "z"]


def data_lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines with data and their numbers; comments begin with ``#``."""
    for line_number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if content:
            yield line_number, content


def words_of(line: str) -> list[str]:
    """Return the words of a line between spaces, tabs, commas or semicolons."""
    return line.replace(",", " ").replace(";", " ").split()


def read_named_columns(path: Path, text: str, columns: Sequence[str] | None) -> PoseTable:
    """Return the poses of a CSV file with the columns x_m, y_m, z_m, qx, qy, qz, qw, perhaps t_s.

    Raises:
        InvalidInputError: It is no CSV file, or a row is no pose; names line, column and text.
    """
    try:
        rows = parse_numbered_csv(text, MAX_POSES, columns)
    except ValueError as error:
        raise InvalidInputError(FIELD, str(path), f"a readable CSV file ({error})") from error
    if not rows:
        raise InvalidInputError(FIELD, str(path), "at least one row below the header")
    has_times = TIME in rows[0][1]
    names = (TIME, *POSE_NUMBERS) if has_times else POSE_NUMBERS
    missing = [name for name in names if name not in rows[0][1]]
    if missing:
        expected = f"the columns {', '.join(POSE_NUMBERS)}; {', '.join(missing)} is not there"
        raise InvalidInputError(f"{path}:1", [str(name) for name in rows[0][1]], expected)
    found = []
    for line, row in rows:
        where = f"{path}:{line}"
        found.append((line, [number(row[name], where, name) for name in names]))
    return _table(path, found, has_times=has_times)


def read_euroc(path: Path, text: str) -> PoseTable:
    """Return the poses of a ground truth of EuRoC: nanoseconds, position, w, x, y, z.

    Raises:
        InvalidInputError: The columns are not those of the standard, or a row is no pose.
    """
    head, *rows = text.splitlines()
    names = [name.split("[")[0].strip() for name in head.split(",")]
    if [name.rpartition("_")[2] for name in names[1:8]] != EUROC_AXES:
        expected = "EuRoC's columns: #timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z"
        raise InvalidInputError(f"{path}:1", head, expected)
    found = []
    for line_number, line in enumerate(rows, start=2):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}:{line_number}"
        stamp, *texts = ([s.strip() for s in line.split(",")] + [""] * 8)[:8]
        stamp_ns = whole_of(stamp)
        if stamp_ns is None:
            expected = f"whole nanoseconds in the column {names[0].lstrip('#') or 'timestamp'}"
            raise InvalidInputError(where, stamp, expected)
        x, y, z, qw, qx, qy, qz = (
            number(text, where, name) for text, name in zip(texts, names[1:8], strict=True)
        )
        # Integers divided once are rounded once.
        found.append((line_number, [stamp_ns / 10**9, x, y, z, qx, qy, qz, qw]))
    return _table(path, found, has_times=True)


def read_tum(path: Path, text: str) -> PoseTable:
    """Return the poses of a TUM file: seconds, position, x, y, z, w.

    Raises:
        InvalidInputError: A row is no pose; names line, column and text.
    """
    return _table(path, _rows(path, text, TUM_NUMBERS), has_times=True)


def read_kitti(path: Path, text: str) -> PoseTable:
    """Return the poses of a KITTI file: rows of a matrix from the camera to the first camera.

    The world is the first camera's optical frame; its z axis becomes ``map``'s x, its y axis -z.

    Raises:
        InvalidInputError: A row is no rotation and shift; names line, column and text.
    """
    rows = _rows(path, text, KITTI_NUMBERS)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.array([values for _, values in rows]).reshape(-1, 3, 4)
    return matrix_table(path, T, [f"{path}:{line}" for line, _ in rows], T_LINK_OPTICAL)


def read_times(path: Path, text: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the (N,) times of a file with one number of seconds in each line, as KITTI's.

    Raises:
        InvalidInputError: A line is no number.
    """
    return np.array([values[0] for _, values in _rows(path, text, ("seconds",))])


def _rows(path: Path, text: str, names: Sequence[str]) -> list[tuple[int, list[float]]]:
    found: list[tuple[int, list[float]]] = []
    for line, content in data_lines(text):
        where, words = f"{path}:{line}", words_of(content)
        if len(words) != len(names):
            what = ", ".join(names) if len(names) <= len(TUM_NUMBERS) else "of a 3 x 4 matrix"
            expected = f"the {len(names)} numbers {what}, not {len(words)}"
            raise InvalidInputError(where, content, expected)
        if len(found) == MAX_POSES:
            raise InvalidInputError(FIELD, str(path), f"at most {MAX_POSES} rows")
        found.append((line, [number(w, where, n) for w, n in zip(words, names, strict=True)]))
    if not found:
        raise InvalidInputError(FIELD, str(path), "at least one row with a pose")
    return found


def _table(path: Path, rows: Sequence[tuple[int, list[float]]], *, has_times: bool) -> PoseTable:
    if not rows:
        raise InvalidInputError(FIELD, str(path), "at least one row with a pose")
    first = int(has_times)
    places = tuple(f"{path}:{line}" for line, _ in rows)
    poses = [
        check_pose(values[first : first + 3], values[first + 3 :], place)
        for place, (_, values) in zip(places, rows, strict=True)
    ]
    times_s = None
    if has_times:
        times_s = np.array([values[0] for _, values in rows])
        if not np.isfinite(times_s).all():
            row = int(np.argmin(np.isfinite(times_s)))
            raise InvalidInputError(places[row], float(times_s[row]), "a finite time")
    positions_m = np.array([pose.position_m for pose in poses])
    quats = np.array([pose.quat_xyzw for pose in poses])
    return PoseTable(path, positions_m, quats, places, times_s)
