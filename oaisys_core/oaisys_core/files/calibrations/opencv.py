"""Matrices that OpenCV's FileStorage wrote: YAML, JSON or XML."""

from __future__ import annotations

import re
from typing import Any

from oaisys_core.errors import InvalidInputError, one_line
from oaisys_core.files.calibrations.records import (
    FIELD,
    CalibratedCamera,
    Calibration,
    focal_and_centre,
    image_size,
    lens,
    unknown_model,
    unread_keys,
)
from oaisys_core.files.documents import MAX_DEPTH

MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "CameraMatrix", "intrinsics", "K", "M")
COEFFICIENTS = (
    "distortion_coefficients",
    "distCoeffs",
    "dist_coeffs",
    "Distortion_Coefficients",
    "distortion",
    "D",
)
WIDTH = ("image_width", "image_Width", "width", "imageWidth")
HEIGHT = ("image_height", "image_Height", "height", "imageHeight")
SIZE = ("image_size", "imageSize", "resolution")
FISHEYE = ("fisheye_model", "fisheye")
SAMPLE = (
    *("calibration_time", "nframes", "nr_of_frames", "board_width", "board_height", "square_size"),
    *("board_size", "aspectRatio", "flags", "avg_reprojection_error"),
    *("per_view_reprojection_errors", "extrinsic_parameters", "image_points", "grid_points"),
)
"""What OpenCV's calibration sample writes beside, which says nothing of the camera."""
SUFFIXES = ("", "1", "2", "3", "4")
MARKS = ("opencv-matrix", "opencv_storage", "%YAML:1.0")
"""Texts, one of which is in each file of OpenCV."""


MAX_INDENTATION = 400
"""Spaces before a line of YAML; each level has at least one."""

_NESTING = re.compile(r"[\[\]{}]|<[^>!?]*[^/>]>")
"""Brackets, and tags of XML that open or close an element."""


def is_opencv(text: str) -> bool:
    """Return whether a file is one of OpenCV."""
    return any(mark in text for mark in MARKS)


def read_opencv(text: str) -> Calibration:
    """Return the cameras of a file: the one of its calibration sample, or ``M1``, ``M2``.

    Raises:
        InvalidInputError: It cannot be read, a value is missing or wrong, or we lack the model.
    """
    import cv2

    _check_depth(text)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        cameras = [
            camera for suffix in SUFFIXES if (camera := _camera(storage, suffix)) is not None
        ]
        keys = storage.root().keys()
        storage.release()
    except (cv2.error, SystemError) as error:
        expected = f"one that it can read ({_reason(error)})"
        raise InvalidInputError(FIELD, "a file of OpenCV", expected) from error
    if not cameras:
        raise InvalidInputError(FIELD, "a file of OpenCV", f"a matrix named {', '.join(MATRIX)}")
    notes = ["OpenCV's files say nothing of the mount"]
    if any(camera.fisheye is None and len(camera.distortion) == 4 for camera in cameras):
        notes.append("four coefficients without fisheye_model are k1, k2, p1 and p2")
    if any(not camera.distortion and camera.fisheye is None for camera in cameras):
        notes.append("a matrix without distortion coefficients is of a lens without distortion")
    each = [name + suffix for name in (*MATRIX, *COEFFICIENTS) for suffix in SUFFIXES]
    unused = unread_keys(dict.fromkeys(keys), (*each, *WIDTH, *HEIGHT, *SIZE, *FISHEYE, *SAMPLE))
    return Calibration(
        "OpenCV FileStorage", tuple(cameras), notes=tuple(notes), unused=tuple(unused)
    )


def _reason(error: Exception) -> str:
    """Return OpenCV's own words; where its constructor fails, they are in the error's cause."""
    found = error if error.__cause__ is None else error.__cause__
    return one_line(str(found).rpartition(" error: ")[2])


def _check_depth(text: str) -> None:
    """Raise if a text is nested so deeply that OpenCV's parsers, which call themselves, crash."""
    depth = deepest = 0
    for mark in _NESTING.findall(text):
        depth += -1 if mark in ("]", "}") or mark.startswith("</") else 1
        deepest = max(deepest, depth)
    indented = max((len(line) - len(line.lstrip()) for line in text.splitlines()), default=0)
    if deepest > MAX_DEPTH or indented > MAX_INDENTATION:
        raise InvalidInputError(FIELD, "a file of OpenCV", f"at most {MAX_DEPTH} levels")


def _camera(storage: Any, suffix: str) -> CalibratedCamera | None:
    matrix = _matrix(storage, MATRIX, suffix)
    if matrix is None:
        return None
    if not storage.getNode(f"xi{suffix}").empty():
        raise unknown_model("cv::omnidir", f"{FIELD}.xi{suffix}")
    where = f"{FIELD}.camera_matrix{suffix}"
    focal_px, centre_px = focal_and_centre(matrix, where)
    coefficients = _matrix(storage, COEFFICIENTS, suffix) or []
    distortion, fisheye = lens(
        coefficients,
        f"{FIELD}.distortion_coefficients{suffix}",
        is_fisheye=bool(_number(storage, FISHEYE)),
    )
    return CalibratedCamera(
        name=f"camera{suffix}",
        size_px=_size(storage),
        focal_px=focal_px,
        centre_px=centre_px,
        distortion=distortion,
        fisheye=fisheye,
    )


def _matrix(storage: Any, names: tuple[str, ...], suffix: str) -> list[float] | None:
    for name in names:
        node = storage.getNode(name + suffix)
        if node.empty():
            continue
        values = node.mat() if node.isMap() else None
        if values is not None:
            return [float(value) for value in values.ravel()]
        if node.isSeq():
            return [float(node.at(index).real()) for index in range(node.size())]
    return None


def _number(storage: Any, names: tuple[str, ...]) -> float | None:
    for name in names:
        node = storage.getNode(name)
        if node.isInt() or node.isReal():
            return float(node.real())
    return None


def _size(storage: Any) -> tuple[int, int] | None:
    width, height = _number(storage, WIDTH), _number(storage, HEIGHT)
    if width is None or height is None:
        pair = _matrix(storage, SIZE, "")
        if pair is None or len(pair) != 2:
            return None
        width, height = pair
    return image_size(width, height, f"{FIELD}.image_width")
