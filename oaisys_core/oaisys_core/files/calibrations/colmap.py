"""COLMAP's cameras.txt and cameras.bin, and the cameras of nerfstudio's transforms.json.

COLMAP puts the centre of the first pixel at (0.5, 0.5), where OpenCV, ROS and we have (0, 0):
https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.records import (
    FIELD,
    KANNALA_BRANDT,
    OPENCV,
    CalibratedCamera,
    Calibration,
    finite,
    image_size,
    lens,
    require_keys,
    unknown_model,
    unread_keys,
)

PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "FOV": ("fx", "fy", "cx", "cy", "omega"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "THIN_PRISM_FISHEYE": (
        *("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"),
    ),
}
"""Parameters by model, in the order of their numbers in cameras.bin."""

NERF_KEYS = (
    *("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y"),
    *("camera_model", "is_fisheye", *OPENCV[:8], "frames", "file_path", "transform_matrix"),
    *("depth_file_path", "mask_path", "colmap_im_id", "sharpness", "ply_file_path"),
    *("applied_transform", "applied_scale", "orientation_override", "aabb_scale"),
)
"""Keys of a camera, and of pictures, poses and scenes, which say nothing of it."""

LACKED = ("FOV", "THIN_PRISM_FISHEYE")
HALF = 0.5
MOST_CAMERAS = 10_000


def read_cameras_text(text: str) -> Calibration:
    """Return the cameras of cameras.txt.

    Raises:
        InvalidInputError: A line is wrong, or we lack the model; the line is named.
    """
    cameras = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not (words := line.split()) or line.startswith("#"):
            continue
        where = f"{FIELD}: line {number}"
        if len(words) < 5:
            raise InvalidInputError(where, line, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        cameras.append(_camera(words[0], words[1], words[2:4], words[4:], where))
    return _calibration("COLMAP cameras", cameras)


def read_cameras_bytes(data: bytes) -> Calibration:
    """Return the cameras of cameras.bin.

    Raises:
        InvalidInputError: It is too short, or we lack the model.
    """
    try:
        cameras = list(_records(data))
    except struct.error as error:
        raise InvalidInputError(FIELD, f"{len(data)} bytes", "a whole cameras.bin") from error
    return _calibration("COLMAP cameras", cameras)


def read_transforms(data: Mapping[str, Any]) -> Calibration:
    """Return the cameras of transforms.json: one for all frames, or those that differ.

    Raises:
        InvalidInputError: A value is missing or wrong, or we lack the model.
    """
    frames = data.get("frames") or [{}]
    cameras: dict[str, CalibratedCamera] = {}
    for index, frame in enumerate(frames):
        if not isinstance(frame, Mapping):
            raise InvalidInputError(f"{FIELD}.frames.{index}", frame, "a mapping")
        found = _nerf_camera({**data, **frame}, f"{FIELD}.frames.{index}")
        cameras.setdefault(repr(found), found)
    named = [
        replace(camera, name=f"camera{'' if len(cameras) == 1 else index}")
        for index, camera in enumerate(cameras.values())
    ]
    unused = {key: None for entry in (data, *frames) for key in unread_keys(entry, NERF_KEYS)}
    return _calibration("nerfstudio transforms", named, tuple(unused))


def _calibration(
    name: str, cameras: Sequence[CalibratedCamera], unused: tuple[str, ...] = ()
) -> Calibration:
    note = "the principal points are half a pixel less than in the file, whose pixels begin at 0"
    notes = (note, "the file says nothing of the mount")
    return Calibration(name, tuple(cameras), notes=notes, unused=unused)


def _records(data: bytes) -> Iterator[CalibratedCamera]:
    (count,) = struct.unpack_from("<Q", data)
    if count > MOST_CAMERAS:
        raise InvalidInputError(f"{FIELD}.cameras", count, f"at most {MOST_CAMERAS}")
    place, models = 8, list(PARAMETERS)
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<iiQQ", data, place)
        where = f"{FIELD}: camera {number}"
        if not 0 <= model < len(models):
            raise unknown_model(f"model {model}", where)
        size = len(PARAMETERS[models[model]])
        values = struct.unpack_from(f"<{size}d", data, place + 24)
        place += 24 + 8 * size
        yield _camera(str(number), models[model], (width, height), values, where)
    if place != len(data):
        raise InvalidInputError(FIELD, f"{len(data)} bytes", f"{place} for {count} cameras")


def _camera(
    number: str, model: str, size: Sequence[Any], values: Sequence[Any], where: str
) -> CalibratedCamera:
    if model not in PARAMETERS or model in LACKED:
        raise unknown_model(model, where)
    names = PARAMETERS[model]
    found = dict(zip(names, finite(values, where, len(names)), strict=True))
    fx, fy = found.get("fx", found.get("f", 0.0)), found.get("fy", found.get("f", 0.0))
    is_fisheye = model.endswith("FISHEYE")
    order = KANNALA_BRANDT if is_fisheye else OPENCV
    coefficients = [found.get(name, 0.0) for name in order]
    distortion, fisheye = lens(coefficients, where, is_fisheye=is_fisheye)
    return CalibratedCamera(
        name=f"camera{number}",
        size_px=image_size(size[0], size[1], where),
        focal_px=(fx, fy),
        centre_px=(found["cx"] - HALF, found["cy"] - HALF),
        distortion=distortion,
        fisheye=fisheye,
    )


def _nerf_camera(data: Mapping[str, Any], where: str) -> CalibratedCamera:
    columns, rows = require_keys(data, ("w", "h"), where)
    width, height = image_size(columns, rows, where)
    if "fl_x" in data:
        fx = finite([data["fl_x"]], f"{where}.fl_x", 1)[0]
    else:
        (angle,) = finite(require_keys(data, ("camera_angle_x",), where), where, 1)
        if not 0 < angle < math.pi:
            raise InvalidInputError(f"{where}.camera_angle_x", angle, "an angle between 0 and pi")
        fx = width / (2 * math.tan(angle / 2))
    given = {"fl_y": fx, "cx": width / 2, "cy": height / 2, **data}
    fy, cx, cy = finite([given[key] for key in ("fl_y", "cx", "cy")], where, 3)
    model = str(data.get("camera_model", "OPENCV"))
    # instant-ngp has no camera_model; this key is its fisheye of OpenCV.
    is_fisheye = model == "OPENCV_FISHEYE" or bool(data.get("is_fisheye"))
    if not is_fisheye and (model not in PARAMETERS or model in LACKED or "FISHEYE" in model):
        raise unknown_model(model, f"{where}.camera_model")
    order = KANNALA_BRANDT if is_fisheye else OPENCV[:8]
    values = finite([data.get(name, 0.0) for name in order], where)
    lens_of_frame = lens(values, where, is_fisheye=is_fisheye)
    centre_px = (cx - HALF, cy - HALF)
    return CalibratedCamera("camera", (width, height), (fx, fy), centre_px, *lens_of_frame)


def is_transforms(data: Any) -> bool:
    """Return whether JSON data have cameras as nerfstudio writes them."""
    return isinstance(data, Mapping) and bool({"fl_x", "camera_angle_x", "frames"} & data.keys())


def is_cameras_text(text: str) -> bool:
    """Return whether a text is a cameras.txt."""
    lines = (line for line in text.splitlines() if line.strip() and line[0] != "#")
    return re.match(r"\s*[0-9]+ +[A-Z_]+ +[0-9]+ ", next(lines, "")) is not None
