"""Reads a calibration of any of the formats that we know, told apart by its content."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.colmap import (
    is_cameras_text,
    is_transforms,
    read_cameras_bytes,
    read_cameras_text,
    read_transforms,
)
from oaisys_core.files.calibrations.euroc import is_sensor, read_sensor
from oaisys_core.files.calibrations.kalibr import is_camchain, is_imu, read_camchain, read_imu
from oaisys_core.files.calibrations.opencv import is_opencv, read_opencv
from oaisys_core.files.calibrations.records import FIELD, Calibration
from oaisys_core.files.calibrations.robots import Robot, is_robot, read_robot
from oaisys_core.files.calibrations.ros import is_camera_info, read_camera_info
from oaisys_core.files.documents import parse_json, read_bytes
from oaisys_core.files.yaml_documents import parse_yaml

MOST_BYTES = 4_000_000
KNOWN = (
    "ROS's camera_info (YAML), Kalibr's camchain or imu (YAML), EuRoC's sensor.yaml, OpenCV's"
    " FileStorage (YAML, JSON, XML), COLMAP's cameras.txt or cameras.bin, nerfstudio's"
    " transforms.json, URDF or SDF"
)


def read_calibration(path: Path) -> Calibration:
    """Return the cameras and IMUs of a calibration, or the sensors of a robot.

    Raises:
        InvalidInputError: It cannot be read, is of no format that we know, a value is missing or
            wrong, or we lack its camera model.
    """
    with _naming(path):
        data = _content(path)
        if is_robot(data, path.suffix):
            return read_robot(data).sensors
        return _read(data, path)


def read_robot_file(path: Path, base: str | None = None, model: str | None = None) -> Robot | None:
    """Return the robot in a file, see `read_robot`; None if it is a calibration.

    Raises:
        InvalidInputError: As of `read_robot`, or the file cannot be read.
    """
    with _naming(path):
        data = _content(path)
        return read_robot(data, base, model) if is_robot(data, path.suffix) else None


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Add the file's name to errors."""
    try:
        yield
    except InvalidInputError as error:
        error.add_note(f"in {path}")
        raise


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise InvalidInputError(FIELD, str(path), f"a file that can be read ({error})") from error


def _read(data: bytes, path: Path) -> Calibration:
    if path.suffix.lower() == ".bin":
        return read_cameras_bytes(data)
    try:
        text = data.decode("utf-8-sig")
        if is_opencv(text):
            return read_opencv(text)
        if is_cameras_text(text):
            return read_cameras_text(text)
        is_json = text.lstrip().startswith("{")
        found = parse_json(text) if is_json else parse_yaml(text.rstrip().removesuffix("---"))
    except ValueError as error:
        raise InvalidInputError(FIELD, "a file", f"{KNOWN} ({error})") from error
    if is_sensor(found):
        return read_sensor(found, path.resolve().parent.name)
    for is_kind, read in (
        (is_camera_info, read_camera_info),
        (is_camchain, read_camchain),
        (is_imu, read_imu),
        (is_transforms, read_transforms),
    ):
        if is_kind(found):
            return read(found)
    raise InvalidInputError(FIELD, found, KNOWN)
