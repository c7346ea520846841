"""Reads a file of poses of any format that we know, told apart by its content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from oaisys_core import extensions
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.csv_tables import MAX_ROW_BYTES
from oaisys_core.files.documents import open_regular, parse_json, read_text
from oaisys_core.files.poses import colmap, nerf_frames, tables
from oaisys_core.files.poses.flight_plans import is_plan
from oaisys_core.files.poses.records import (
    FIELD,
    MAX_POSES,
    PoseSelection,
    PoseTable,
    number,
    without_repeats,
)

MAX_BYTES = MAX_POSES * MAX_ROW_BYTES
MCAP = b"\x89MCAP0\r\n"
ZSTD = b"\x28\xb5\x2f\xfd"
MOST_FILES = 100_000
"""Names of a folder that are looked at."""

PoseReader = Callable[[Path, PoseSelection], PoseTable]

HEAD_BYTES = 65_536
"""Bytes at a file's beginning that tell its format."""

KNOWN = (
    "a CSV file with x_m, y_m, z_m, qx, qy, qz, qw, EuRoC's CSV, a TUM or KITTI file, COLMAP's"
    " images.txt or images.bin, transforms.json, or an MCAP bag"
)
"""The formats, for errors."""

CONVERTED = {
    b"#ROSBAG": "a bag of ROS 1: evo_traj bag FILE TOPIC --save_as_tum makes a TUM file of it,"
    " rosbags-convert --src FILE --dst FOLDER --dst-storage mcap an MCAP bag",
    b"SQLite format 3": "an SQLite bag of ROS 2: evo_traj bag2 FOLDER TOPIC --save_as_tum makes a"
    " TUM file of it, rosbags-convert --src FOLDER --dst FOLDER2 --dst-storage mcap an MCAP bag",
    ZSTD: "compressed as a whole: zstd -d FILE",
    b"\x1f\x8b": "compressed as a whole: gunzip FILE",
    b"PK\x03\x04": "an archive: unzip FILE",
}
"""What is not read, by first bytes, and what makes a file of it that is."""


def read_pose_table(path: Path, selection: PoseSelection | None = None) -> PoseTable:
    """Return the poses of a file.

    Where several rows have the same stamp, the first counts.

    Raises:
        InvalidInputError: It cannot be read, is of no format that we know, or a pose is wrong;
            names line, column and text.
    """
    chosen = selection or PoseSelection()
    try:
        table = _read(path, chosen)
    except (OSError, ValueError) as error:
        raise InvalidInputError(FIELD, str(path), f"a readable file ({error})") from error
    return without_repeats(table)


def with_times(table: PoseTable, path: Path) -> PoseTable:
    """Return a table without times with those of a file, one number of seconds in each line.

    Raises:
        InvalidInputError: The table has times, or the file has not one for each pose.
    """
    if table.times_s is not None:
        expected = f"none, because {table.path.name} has times"
        raise InvalidInputError("times_file", str(path), expected)
    try:
        times_s = tables.read_times(path, read_text(path, MAX_BYTES).removeprefix("\ufeff"))
    except (OSError, ValueError) as error:
        raise InvalidInputError("times_file", str(path), f"a readable file ({error})") from error
    if len(times_s) != len(table.places):
        expected = f"one for each of the {len(table.places)} poses in {table.path.name}"
        raise InvalidInputError(str(path), f"{len(times_s)} times", expected)
    return without_repeats(replace(table, times_s=times_s))


def is_named_columns_file(path: Path) -> bool:
    """Return whether a file is a CSV file with a header; `read_pose_table` says what is wrong."""
    try:
        with open_regular(path, colmap.MAX_MODEL_BYTES) as file:
            beginning = file.read(HEAD_BYTES).decode("utf-8", errors="replace")
    except (OSError, ValueError):
        return False
    text = beginning.removeprefix("\ufeff")
    is_other = text.lstrip().startswith(("{", "[")) or is_euroc(text) or _is_colmap(path, text)
    return not is_other and "\0" not in text and is_named_columns(text)


def _read(path: Path, selection: PoseSelection) -> PoseTable:
    if path.is_dir():
        return _read_folder(path, selection)
    with open_regular(path, colmap.MAX_MODEL_BYTES) as file:
        head = file.read(HEAD_BYTES)
    for first_bytes, what in CONVERTED.items():
        if head.startswith(first_bytes):
            raise InvalidInputError(FIELD, str(path), f"{KNOWN}. It is {what}")
    if head.startswith(MCAP):
        return _read_bag(path, selection)
    for name in ("topic", "frame"):
        if getattr(selection, name) is not None:
            expected = f"none, because {path.name} is no bag"
            raise InvalidInputError(name, getattr(selection, name), expected)
    if path.suffix.lower() == ".bin":
        return colmap.read_images_binary(path)
    beginning = head.decode("utf-8", errors="replace").removeprefix("\ufeff")
    if selection.columns is None and _is_colmap(path, beginning):
        return colmap.read_images_text(path)
    text = read_text(path, MAX_BYTES).removeprefix("\ufeff")
    if text.lstrip().startswith(("{", "[")):
        return _read_json(path, parse_json(text))
    return _read_text(path, text, selection)


def _read_folder(path: Path, selection: PoseSelection) -> PoseTable:
    names = sorted(file.name for file in islice(path.iterdir(), MOST_FILES))
    if any(name.endswith(".mcap") for name in names):
        return _read_bag(path, selection)
    if any(name.endswith(".db3") for name in names):
        expected = f"{KNOWN}. It is {CONVERTED[b'SQLite format 3']}"
    elif any(name.endswith((".mcap.zstd", ".db3.zstd")) for name in names):
        expected = f"{KNOWN}. Its files are {CONVERTED[ZSTD]}"
    else:
        expected = f"{KNOWN}; a folder is read if it is an MCAP bag"
    raise InvalidInputError(FIELD, str(path), expected)


def _read_bag(path: Path, selection: PoseSelection) -> PoseTable:
    try:
        read: PoseReader = extensions.load(extensions.POSE_READERS, "mcap")
    except ConfigError as error:
        expected = (
            "an installed package oaisys_ros_bridge, which reads MCAP bags, or a TUM file, which"
            f" evo_traj mcap FILE TOPIC --save_as_tum makes of one ({error})"
        )
        raise InvalidInputError(FIELD, str(path), expected) from error
    return read(path, selection)


def _read_text(path: Path, text: str, selection: PoseSelection) -> PoseTable:
    if selection.columns is not None:
        return tables.read_named_columns(path, text, selection.columns)
    if is_euroc(text):
        return tables.read_euroc(path, text)
    if is_named_columns(text):
        return tables.read_named_columns(path, text, None)
    line, first = next(tables.data_lines(text), (1, ""))
    if path.suffix.lower() == ".csv" and "," in first:
        expected = "a header in the first row, or the key columns with the names of the columns"
        raise InvalidInputError(f"{path}:{line}", first, expected)
    if len(tables.words_of(first)) == len(tables.KITTI_NUMBERS):
        return tables.read_kitti(path, text)
    return tables.read_tum(path, text)


def _read_json(path: Path, data: Any) -> PoseTable:
    if nerf_frames.is_frames(data):
        return nerf_frames.read_frames(path, data)
    if is_plan(data):
        expected = "poses in metres; oaisys render --poses alone takes a plan's places in degrees"
        raise InvalidInputError(FIELD, str(path), expected)
    found = sorted(data) if isinstance(data, dict) else data
    raise InvalidInputError(FIELD, found, f"{KNOWN}; {path} is other JSON")


def is_euroc(text: str) -> bool:
    """Return whether a text begins with the header of EuRoC's ground truths."""
    head = text.partition("\n")[0]
    return head.startswith("#") and "," in head and head.lstrip("# ").startswith("timestamp")


def is_named_columns(text: str) -> bool:
    """Return whether the first row of a text has names, not numbers."""
    _, first = next(tables.data_lines(text), (1, ""))
    return bool(first) and not _is_number(tables.words_of(first)[0] if first else "")


def _is_colmap(path: Path, beginning: str) -> bool:
    if path.name.lower() == "images.txt" or "two lines of data per image" in beginning:
        return True
    _, first = next(tables.data_lines(beginning), (1, ""))
    words = first.split()
    count = len(colmap.NUMBERS)
    return (
        len(words) > count
        and all(map(_is_number, words[:count]))
        and words[0].isdecimal()
        and not _is_number(words[count])
    )


def _is_number(word: str) -> bool:
    try:
        number(word, "", "")
    except InvalidInputError:
        return False
    return True
