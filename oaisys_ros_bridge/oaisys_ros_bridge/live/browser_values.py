"""What a browser says of itself, checked: viser hands on whatever comes through the WebSocket."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import viser
import viser.transforms

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray
from oaisys_mapping.report.browser_messages import MAX_COORDINATE_M

MAX_ASPECT = 20.0
"""Of a window, and 1 over it; the picture's bars are as long as the window at most."""

MAX_TEXT = 200
"""Letters of a field."""


class BrowserPose(NamedTuple):
    """Where a browser's camera is.

    Attributes:
        look_at_m: (3,) the point that it turns around.
        R_map_camera: (3, 3) orientation of its optical frame (z forward, x right, y down).
    """

    look_at_m: FloatArray
    R_map_camera: FloatArray


def pose_of(camera: viser.CameraHandle) -> BrowserPose | None:
    """Return where a browser's camera is; None: what it says is no pose."""
    look_at_m, wxyz = _numbers(camera.look_at, 3), _numbers(camera.wxyz, 4)
    if look_at_m is None or wxyz is None or np.abs(look_at_m).max() > MAX_COORDINATE_M:
        return None
    if not 0.5 < np.linalg.norm(wxyz) < 2.0:
        return None
    R_map_camera = viser.transforms.SO3(wxyz / np.linalg.norm(wxyz)).as_matrix()
    return BrowserPose(look_at_m, np.asarray(R_map_camera, np.float64))


def aspect_of(camera: viser.CameraHandle) -> float:
    """Return the width of a browser's window over its height, at most `MAX_ASPECT`.

    A window without a height, as a minimized one, counts as square.
    """
    size = _numbers((camera.image_width, camera.image_height), 2)
    if size is None or not (size > 0).all():
        return 1.0
    return float(np.clip(size[0] / size[1], 1 / MAX_ASPECT, MAX_ASPECT))


def number_of(field: Any) -> float:
    """Return the value of a slider or of a field for a number.

    Raises:
        InvalidInputError: It is no number within the field's limits.
    """
    low = -math.inf if field.min is None else field.min
    high = math.inf if field.max is None else field.max
    try:
        value = float(field.value)
    except (OverflowError, TypeError, ValueError):  # viser takes whole numbers of any length
        value = math.nan
    if not (math.isfinite(value) and low <= value <= high):
        raise InvalidInputError(str(field.label), field.value, f"a number from {low:g} to {high:g}")
    return value


def text_of(field: Any) -> str:
    """Return what a field for text has, without spaces at its ends.

    Raises:
        InvalidInputError: It is too long.
    """
    text = str(field.value).strip()
    if len(text) > MAX_TEXT:
        raise InvalidInputError(str(field.label), text, f"at most {MAX_TEXT} letters")
    return text


def _numbers(values: Any, count: int) -> FloatArray | None:
    """Return (count,) finite numbers; None: the values are none."""
    try:
        numbers = np.array(values, np.float64)
    except (OverflowError, TypeError, ValueError):
        return None
    return numbers if numbers.shape == (count,) and np.isfinite(numbers).all() else None
