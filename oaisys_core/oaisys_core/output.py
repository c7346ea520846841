"""Samples as files, laid out as the original simulator lays them out.

``batch_0001/camera/0001camera_rgb_00.png``, ``..._pinhole_depth_00.exr``,
``..._semantic_label_00.png`` and ``..._instance_label_00.png``; beside them one ``poses.csv`` a
batch.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.exr import write_grey
from oaisys_core.geometry import checked_pose
from oaisys_core.types import DEPTH, INSTANCE, RGB, Frame, Pose, Sample

SUFFIXES = {
    RGB: "rgb_00.png",
    DEPTH: "pinhole_depth_00.exr",
    INSTANCE: "instance_label_00.png",
}
POSE_COLUMNS = ("sample_id", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


class SampleWriter:
    """Writes samples below one folder."""

    def __init__(self, out: Path) -> None:
        self._out = out

    def write(self, sample: Sample) -> list[Path]:
        """Write all frames of a sample and append its pose; return the image files.

        Raises:
            RenderError: A file could not be written.
        """
        batch = self._out / f"batch_{sample.batch_id:04d}"
        paths = []
        for frame in sample.frames:
            name = f"{sample.sample_id:04d}{frame.sensor}_{file_suffix(frame.modality)}"
            path = batch / frame.sensor / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_image(path, frame)
            paths.append(path)
        self._append_pose(batch / "poses.csv", sample)
        return paths

    def _append_pose(self, path: Path, sample: Sample) -> None:
        is_new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if is_new:
                writer.writerow(POSE_COLUMNS)
            pose = sample.rig_pose
            writer.writerow((sample.sample_id, *pose.position_m, *pose.quat_xyzw))


def read_poses(path: Path, columns: Sequence[str] | None = None) -> list[Pose]:
    """Return the poses of a CSV file with the columns of `POSE_COLUMNS` (``sample_id`` optional).

    Args:
        path: The file.
        columns: Names of its columns; None: they are in its first line.

    Raises:
        InvalidInputError: The file cannot be read or a row is no pose; names line and value.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file, columns))
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError("poses", str(path), f"a readable CSV file ({error})") from error
    poses = []
    for line, row in enumerate(rows, start=2 if columns is None else 1):
        try:
            numbers = [float(row[column]) for column in POSE_COLUMNS[1:]]
        except (KeyError, TypeError, ValueError) as error:
            expected = f"numbers in the columns {', '.join(POSE_COLUMNS[1:])}"
            raise InvalidInputError(f"{path}:{line}", dict(row), expected) from error
        poses.append(checked_pose(numbers[:3], numbers[3:], f"{path}:{line}"))
    if not poses:
        raise InvalidInputError("poses", str(path), "at least one row below the header")
    return poses


def file_suffix(modality: str) -> str:
    """Return how the file of a modality's image ends."""
    if modality.startswith("semantic_"):
        return f"semantic_label_{int(modality.removeprefix('semantic_')):02d}.png"
    return SUFFIXES[modality]


def write_image(path: Path, frame: Frame) -> None:
    """Write a frame: 8-bit colour PNG, 32-bit float EXR (metres) or 16-bit label PNG.

    Raises:
        RenderError: It could not be written, or a label does not fit 16 bits.
    """
    data = frame.data
    if frame.modality == DEPTH:
        write_grey(path, data)
        return
    if frame.modality == RGB:
        data = np.ascontiguousarray(data[..., ::-1])
    elif frame.modality == INSTANCE:
        if data.max(initial=0) > np.iinfo(np.uint16).max:
            raise RenderError(f"{path.name}: an instance id is above 65535, too large for a PNG")
        data = data.astype(np.uint16)
    try:
        written = cv2.imwrite(str(path), data)
    except cv2.error as error:
        raise RenderError(f"{path}: {error}") from error
    if not written:
        raise RenderError(f"{path}: could not be written")
