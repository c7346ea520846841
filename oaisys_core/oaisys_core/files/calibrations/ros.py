"""ROS's camera_info: files of camera_calibration, and messages as `ros2 topic echo` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.files.calibrations.records import (
    FIELD,
    CalibratedCamera,
    Calibration,
    focal_and_centre,
    frame_name,
    image_size,
    lens,
    require_keys,
    unknown_model,
    unread_keys,
)

PLUMB_BOB = ("plumb_bob", "rational_polynomial", "")
FISHEYE = ("equidistant", "fisheye")
MATRIX = ("camera_matrix", "k", "K")
COEFFICIENTS = ("distortion_coefficients", "d", "D")
RECTIFICATION = ("rectification_matrix", "r", "R")
PROJECTION = ("projection_matrix", "p", "P")
READ = (
    *("image_width", "image_height", "width", "height", "camera_name", "header"),
    *("distortion_model", "binning_x", "binning_y", "roi"),
    *(*MATRIX, *COEFFICIENTS, *RECTIFICATION, *PROJECTION),
)
"""Keys that are read, and the projection of rectified images, which follows from the others."""


def is_camera_info(data: Any) -> bool:
    """Return whether YAML data are ROS's camera information."""
    return isinstance(data, Mapping) and "distortion_model" in data


def read_camera_info(data: Mapping[str, Any]) -> Calibration:
    """Return the camera of sensor_msgs/CameraInfo, in either of its two spellings.

    Raises:
        InvalidInputError: A value is missing or wrong, or we lack the model.
    """
    is_message = "image_width" not in data
    size_keys = ("width", "height") if is_message else ("image_width", "image_height")
    width, height = require_keys(data, size_keys, FIELD)
    matrix, coefficients = (_numbers(data, keys, is_needed=True) for keys in (MATRIX, COEFFICIENTS))
    focal_px, centre_px = focal_and_centre(matrix, f"{FIELD}.camera_matrix")
    model = str(data["distortion_model"])
    if model not in (*FISHEYE, *PLUMB_BOB):
        raise unknown_model(model, f"{FIELD}.distortion_model")
    where = f"{FIELD}.distortion_coefficients"
    distortion, fisheye = lens(coefficients, where, is_fisheye=model in FISHEYE)
    name = data.get("camera_name") or _frame_of(data)
    camera = CalibratedCamera(
        name=frame_name(name, "camera"),
        size_px=image_size(width, height, f"{FIELD}.{size_keys[0]}"),
        focal_px=focal_px,
        centre_px=centre_px,
        distortion=distortion,
        fisheye=fisheye,
    )
    notes, unused = tuple(_notes(data)), tuple(unread_keys(data, READ))
    return Calibration("ROS camera_info", (camera,), notes=notes, unused=unused)


def _numbers(data: Mapping[str, Any], keys: tuple[str, ...], is_needed: bool = False) -> Any:
    """Return the numbers under the first of the keys that is there, else none if that may be."""
    key = next((key for key in keys if key in data), None)
    if key is None:
        return require_keys(data, keys[:1], FIELD) if is_needed else ()
    found = data[key]
    if isinstance(found, Mapping):
        (found,) = require_keys(found, ("data",), f"{FIELD}.{key}")
    return () if found is None else found


def _frame_of(data: Mapping[str, Any]) -> str:
    header = data.get("header")
    frame = header.get("frame_id", "") if isinstance(header, Mapping) else ""
    return str(frame).removesuffix("_optical_frame").removesuffix("_frame")


def _notes(data: Mapping[str, Any]) -> list[str]:
    notes = ["camera_info says nothing of the mount"]
    rectification = _numbers(data, RECTIFICATION)
    if list(rectification) not in ([], [1, 0, 0, 0, 1, 0, 0, 0, 1]):
        notes.append("the rectification matrix is not used: images are those of the lens")
    binning = [data.get("binning_x", 0), data.get("binning_y", 0)]
    roi = data.get("roi")
    if any(value not in (0, 1) for value in binning) or (
        isinstance(roi, Mapping) and any(roi.values())
    ):
        notes.append(
            "binning and the region of interest are not used: the whole sensor is rendered"
        )
    return notes
