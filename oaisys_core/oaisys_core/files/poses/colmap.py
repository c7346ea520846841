"""Poses of the images of a COLMAP model: images.txt and images.bin.

https://colmap.github.io/format.html: they take points from the world to the camera.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import open_regular
from oaisys_core.files.poses.records import FIELD, MAX_POSES, PoseTable, matrix_table, number
from oaisys_core.geometry import check_pose, invert, pose_to_matrix
from oaisys_core.types import FloatArray

MAX_MODEL_BYTES = 2**31
"""Size of a file: each image has thousands of points, which are left out."""

NUMBERS = ("IMAGE_ID", "QW", "QX", "QY", "QZ", "TX", "TY", "TZ", "CAMERA_ID")
LAYOUT = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
MAX_NAME = 4096
POINT_BYTES = 24

_POINTS = re.compile(rb"[-+0-9.eEnaif \t]*")
_IMAGE = struct.Struct("<I7dI")
_LOG = logging.getLogger(__name__)

Image = tuple[str, list[float]]
"""Where an image stands, and its numbers in the order of `NUMBERS`."""


def read_images_text(path: Path) -> PoseTable:
    """Return the poses of images.txt: one for each image, in the order of the file.

    Raises:
        InvalidInputError: A line is wrong; names line, column and text.
    """
    with open_regular(path, MAX_MODEL_BYTES) as file:
        return _table(path, _text_images(path, file))


def read_images_binary(path: Path) -> PoseTable:
    """Return the poses of images.bin: one for each image, in the order of the file.

    Raises:
        InvalidInputError: It is too short or too long.
    """
    with open_regular(path, MAX_MODEL_BYTES) as file:
        try:
            return _table(path, _binary_images(path, file))
        except struct.error as error:
            raise InvalidInputError(FIELD, str(path), "a whole images.bin") from error


def _text_images(path: Path, file: BinaryIO) -> Iterator[Image]:
    points_of = None
    for line_number, raw in enumerate(file, start=1):
        where, line = f"{path}:{line_number}", raw.removeprefix(b"\xef\xbb\xbf").strip()
        if points_of is not None:
            # Every second line belongs to the image before it, even if it is empty.
            if line.startswith(b"#") or not _POINTS.fullmatch(line) or len(line.split()) % 3:
                expected = f"the points of {points_of}: X, Y, POINT3D_ID, ..., or an empty line"
                raise InvalidInputError(where, line[:80].decode(errors="replace"), expected)
            points_of = None
        elif line and not line.startswith(b"#"):
            words = line.decode(errors="replace").split(maxsplit=len(NUMBERS))
            if len(words) <= len(NUMBERS):
                raise InvalidInputError(where, " ".join(words), LAYOUT)
            yield where, [number(w, where, n) for w, n in zip(words, NUMBERS, strict=False)]
            points_of = words[-1]


def _binary_images(path: Path, file: BinaryIO) -> Iterator[Image]:
    (count,) = struct.unpack("<Q", file.read(8))
    for index in range(count):
        head = _IMAGE.unpack(file.read(_IMAGE.size))
        name = _name(file)
        (points,) = struct.unpack("<Q", file.read(8))
        end = file.tell() + POINT_BYTES * points
        if end > MAX_MODEL_BYTES or file.seek(0, 2) < end:
            raise struct.error("points are missing")
        file.seek(end)
        yield f"{path}: image {index + 1}, {name}", list(head)
    if file.read(1):
        raise InvalidInputError(FIELD, str(path), f"an images.bin that ends after {count} images")


def _name(file: BinaryIO) -> str:
    name = bytearray()
    while (byte := file.read(1)) != b"\0":
        if not byte or len(name) == MAX_NAME:
            raise struct.error("a name does not end")
        name += byte
    return name.decode(errors="replace")


def _table(path: Path, images: Iterator[Image]) -> PoseTable:
    places: list[str] = []
    T_world_camera: list[FloatArray] = []
    cameras = set()
    for where, (_, qw, qx, qy, qz, *shift, camera) in images:
        if len(places) == MAX_POSES:
            raise InvalidInputError(FIELD, str(path), f"at most {MAX_POSES} images")
        pose = check_pose(shift, (qx, qy, qz, qw), where)
        T_world_camera.append(invert(pose_to_matrix(pose)))
        places.append(where)
        cameras.add(camera)
    if not places:
        raise InvalidInputError(FIELD, str(path), "at least one image")
    if len(cameras) > 1:
        _LOG.warning(
            "%s: has images of %d cameras; all become poses of one camera of the rig",
            path,
            len(cameras),
        )
    return matrix_table(path, T_world_camera, places)
