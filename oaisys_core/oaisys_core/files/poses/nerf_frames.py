"""Poses of the frames of transforms.json, as nerfstudio, instant-ngp and NeRF's data have them.

https://docs.nerf.studio/quickstart/data_conventions.html: cameras as OpenGL's, x right, y up,
z backward; the world has z up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses.records import FIELD, MAX_POSES, PoseTable, matrix_table
from oaisys_core.geometry import T_OPTICAL_BLENDER, invert
from oaisys_core.types import FloatArray

T_OPENGL_OPTICAL: FloatArray = invert(T_OPTICAL_BLENDER)
"""Blender's camera is OpenGL's."""


def read_frames(path: Path, data: Mapping[str, Any]) -> PoseTable:
    """Return the poses of all frames, in the order of the file.

    Raises:
        InvalidInputError: A frame has no matrix of a rotation and a shift; names its place.
    """
    frames = data["frames"]
    if not isinstance(frames, Sequence) or isinstance(frames, str) or not frames:
        raise InvalidInputError(f"{path}: frames", frames, "a list of at least one frame")
    if len(frames) > MAX_POSES:
        raise InvalidInputError(f"{path}: frames", len(frames), f"at most {MAX_POSES} frames")
    places, found = [], []
    for index, frame in enumerate(frames):
        where = f"{path}: frames.{index}.transform_matrix"
        matrix = frame.get("transform_matrix") if isinstance(frame, Mapping) else None
        found.append(_matrix(matrix, where) @ T_OPENGL_OPTICAL)
        places.append(where)
    return matrix_table(path, found, places)


def _matrix(rows: Any, where: str) -> FloatArray:
    expected = "a matrix of 4 x 4 or 3 x 4 numbers"
    numbers = (int, float)
    if not isinstance(rows, list) or len(rows) not in (3, 4):
        raise InvalidInputError(where, rows, expected)
    for row in rows:
        is_row = isinstance(row, list) and len(row) == 4
        if not is_row or not all(type(value) in numbers for value in row):
            raise InvalidInputError(where, row, expected)
    T = np.eye(4)
    T[: len(rows)] = rows
    return T


def is_frames(data: Any) -> bool:
    """Return whether JSON data have frames, as a transforms.json."""
    return isinstance(data, Mapping) and "frames" in data and FIELD not in data
