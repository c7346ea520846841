"""Writing and reading the points of lidars as PCD files (version 0.7, binary).

PCL, Open3D and CloudCompare read them. The fields are those of `oaisys_core.types.point_dtype`, in
their types; the viewpoint is the lidar's pose in ``map`` at the beginning of the scan.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.numbers import int_of
from oaisys_core.geometry import pose_from_matrix
from oaisys_core.output.files import write_bytes
from oaisys_core.types import LidarScan, point_dtype

POINTS_SUFFIX = "points_00.pcd"
"""End of the name of a file of points."""

_LAST_LINE = b"DATA binary\n"


def write_points(path: Path, scan: LidarScan) -> None:
    """Write a scan's points; inverse: `read_points`.

    Raises:
        RenderError: It could not be written; there is no partial file.
    """
    write_bytes(path, encode_points(scan))


def encode_points(scan: LidarScan) -> bytes:
    """Return the file of a scan's points; inverse: `decode_points`."""
    points = scan.data
    names = points.dtype.names or ()
    types = [points.dtype[name] for name in names]
    pose = pose_from_matrix(scan.T_map_lidar)
    qx, qy, qz, qw = pose.quat_xyzw
    viewpoint = (*pose.position_m, qw, qx, qy, qz)
    header = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(str(each.itemsize) for each in types),
        "TYPE": " ".join(each.kind.upper() for each in types),
        "COUNT": " ".join("1" for _ in types),
        "WIDTH": str(len(points)),
        "HEIGHT": "1",
        "VIEWPOINT": " ".join(repr(float(value)) for value in viewpoint),
        "POINTS": str(len(points)),
    }
    lines = "".join(f"{key} {value}\n" for key, value in header.items())
    return lines.encode() + _LAST_LINE + points.tobytes()


def read_points(path: Path) -> NDArray[Any]:
    """Return the points of a file that `write_points` wrote.

    Raises:
        InvalidInputError: It cannot be read, or has other fields.
    """
    try:
        file = path.read_bytes()
    except OSError as error:
        raise InvalidInputError("points", str(path), f"a readable file ({error})") from error
    return decode_points(file, str(path))


def decode_points(file: bytes, name: str) -> NDArray[Any]:
    """Return the points in a file's bytes; errors call it ``name``.

    Raises:
        InvalidInputError: They are no file of points, or have other fields.
    """
    try:
        head, _, data = file.partition(_LAST_LINE)
        lines = dict(line.split(" ", 1) for line in head.decode().splitlines())
        usual = point_dtype().names or ()
        dtype = point_dtype([each for each in lines["FIELDS"].split() if each not in usual])
        points = np.frombuffer(data, dtype, int_of(lines["POINTS"]))
    except (KeyError, ValueError, OverflowError) as error:
        raise InvalidInputError("points", name, f"a PCD file of a lidar ({error})") from error
    return points
