"""What a calibration says, in the conventions of `oaisys_core.types.PinholeIntrinsics`."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.files.numbers import float_of
from oaisys_core.geometry import T_LINK_OPTICAL, invert, is_rigid, pose_from_matrix, transform
from oaisys_core.types import FloatArray

FIELD = "calibration"
BROWN_CONRADY = ("k1", "k2", "p1", "p2", "k3")
KANNALA_BRANDT = ("k1", "k2", "k3", "k4")
BEYOND = ("k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
"""Coefficients of OpenCV's longer models, after those of `BROWN_CONRADY`."""
OPENCV = (*BROWN_CONRADY, *BEYOND)
OPENCV_COUNTS = (0, 4, 5, 8, 12, 14)
"""Numbers of coefficients that a model of OpenCV may have."""

_PLAIN_KEY = re.compile(r"[\w.+-]{1,80}")

MODELS = "pinhole without distortion, with Brown-Conrady's (plumb_bob, radtan), or equidistant"


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of a calibration; pixel centres are at integers.

    Attributes:
        name: Name in the file, or one that says which it is.
        size_px: Width and height; None if the file does not say.
        focal_px: fx and fy.
        centre_px: cx and cy; None for the centre of the image.
        distortion: Coefficients by name of `BROWN_CONRADY`; empty for none.
        fisheye: Coefficients by name of `KANNALA_BRANDT`; None for a pinhole camera.
        T_base_optical: (4, 4) pose of its optical frame on the rig; None if the file does not say.
        rate_hz: Images per second; None if the file does not say.
        modalities: What it measures; empty if the file does not say.
    """

    name: str
    size_px: tuple[int, int] | None
    focal_px: tuple[float, float]
    centre_px: tuple[float, float] | None
    distortion: dict[str, float] = field(default_factory=dict)
    fisheye: dict[str, float] | None = None
    T_base_optical: FloatArray | None = None
    rate_hz: float | None = None
    modalities: tuple[str, ...] = ()

    def config(self) -> dict[str, Any]:
        """Return the keys of a camera in a configuration, without its name."""
        found: dict[str, Any] = {}
        if self.size_px is not None:
            found["width_px"], found["height_px"] = self.size_px
        found["fx_px"], found["fy_px"] = self.focal_px
        if self.centre_px is not None:
            found["cx_px"], found["cy_px"] = self.centre_px
        if self.fisheye is not None:
            found["fisheye"] = self.fisheye
        elif any(self.distortion.values()):
            found["distortion"] = self.distortion
        if self.T_base_optical is not None:
            found |= mount(self.T_base_optical @ invert(T_LINK_OPTICAL))
        if self.rate_hz is not None:
            found["rate_hz"] = self.rate_hz
        if self.modalities:
            found["modalities"] = list(self.modalities)
        return found


@dataclass(frozen=True)
class Calibration:
    """What a file says of sensors.

    Attributes:
        format: Name of its format.
        cameras: Its cameras, in the file's order.
        imus: The keys of its IMUs in a configuration.
        notes: What was assumed, and what of the file is not used.
        lidars: The keys of its lidars in a configuration.
        faults: Those of ``sensors.faults``.
        unused: Keys of the file that nobody reads, by their paths.
    """

    format: str
    cameras: tuple[CalibratedCamera, ...] = ()
    imus: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    lidars: tuple[dict[str, Any], ...] = ()
    faults: Mapping[str, float] = field(default_factory=dict)
    unused: tuple[str, ...] = ()

    def comments(self) -> tuple[str, ...]:
        """Return the notes, and one that names the keys that nobody reads."""
        return (*self.notes, *([f"not used: {', '.join(self.unused)}"] if self.unused else ()))

    def camera(self, name: str | None) -> CalibratedCamera:
        """Return the camera of a name, or the only one.

        Raises:
            InvalidInputError: There is none, or there are several and no name is given.
        """
        names = [camera.name for camera in self.cameras]
        if name is None and len(names) == 1:
            return self.cameras[0]
        if name not in names:
            raise InvalidInputError(f"{FIELD}.camera", name, f"one of {', '.join(names) or 'none'}")
        return self.cameras[names.index(name)]


def mount(T_base_sensor: FloatArray) -> dict[str, list[float]]:
    """Return the keys of a sensor's pose in a configuration."""
    pose = pose_from_matrix(T_base_sensor)
    return {
        "mount_position_m": [float(value) for value in pose.position_m],
        "mount_quat_xyzw": [float(value) for value in pose.quat_xyzw],
    }


def lens(
    values: Sequence[float], where: str, *, is_fisheye: bool
) -> tuple[dict[str, float], dict[str, float] | None]:
    """Return ``distortion`` and ``fisheye`` of a `CalibratedCamera` with these coefficients.

    Raises:
        InvalidInputError: They are of a model that we lack.
    """
    return (
        ({}, kannala_brandt(values, where)) if is_fisheye else (brown_conrady(values, where), None)
    )


def brown_conrady(values: Sequence[float], where: str) -> dict[str, float]:
    """Return coefficients in OpenCV's order (k1, k2, p1, p2, k3, ...) by name.

    Raises:
        InvalidInputError: A coefficient that our model lacks is not 0, or there are too many.
    """
    if len(values) not in OPENCV_COUNTS:
        expected = f"{', '.join(map(str, OPENCV_COUNTS[:-1]))} or {OPENCV_COUNTS[-1]} of them"
        raise InvalidInputError(where, f"{len(values)} coefficients", expected)
    found = dict(zip(OPENCV, finite(values, where), strict=False))
    for name in BEYOND:
        if found.pop(name, 0.0):
            model = "thin prism" if name[0] == "s" else "tilted" if name[0] == "t" else "rational"
            raise InvalidInputError(where, f"{name} of a {model} model", f"a camera {MODELS}")
    return found


def kannala_brandt(values: Sequence[float], where: str) -> dict[str, float]:
    """Return the four coefficients of an equidistant fisheye by name; without any there are none.

    Raises:
        InvalidInputError: There are others.
    """
    if len(values) not in (0, len(KANNALA_BRANDT)):
        expected = "0 or 4 of them, as of a fisheye"
        raise InvalidInputError(where, f"{len(values)} coefficients", expected)
    return dict(zip(KANNALA_BRANDT, finite(values, where), strict=False))


def unknown_model(model: object, where: str) -> InvalidInputError:
    """Return the error for a camera model that we lack."""
    return InvalidInputError(where, model, f"a camera {MODELS}")


def finite(values: Any, where: str, count: int | None = None) -> list[float]:
    """Return numbers as floats.

    Raises:
        InvalidInputError: They are not a list of finite numbers, or not ``count``.
    """
    wanted = "finite numbers" if count is None else f"{count} finite numbers"
    try:
        numbers = [float_of(value) if isinstance(value, str) else float(value) for value in values]
    except (TypeError, ValueError) as error:
        raise InvalidInputError(where, values, wanted) from error
    if not np.isfinite(numbers).all() or count not in (None, len(numbers)):
        raise InvalidInputError(where, quote(values), wanted)
    return numbers


def focal_and_centre(values: Any, where: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return (fx, fy) and (cx, cy) of the nine values of a camera matrix, row by row.

    Raises:
        InvalidInputError: They are others, or have skew or a scale, which our cameras lack.
    """
    K = finite(values, where, 9)
    if K[1] or K[3] or K[6] or K[7] or K[8] != 1:
        raise InvalidInputError(where, K, "fx, 0, cx, 0, fy, cy, 0, 0, 1")
    return (K[0], K[4]), (K[2], K[5])


def image_size(width: Any, height: Any, where: str) -> tuple[int, int]:
    """Return a size in pixels, which the file gives as whole numbers."""
    numbers = finite((width, height), where, 2)
    if any(number != int(number) or number < 1 for number in numbers):
        raise InvalidInputError(where, [width, height], "a width and a height in whole pixels")
    return int(numbers[0]), int(numbers[1])


def rigid(rows: Any, where: str) -> FloatArray:
    """Return a (4, 4) rigid transform, whose rotation is brought to the next exact one.

    Raises:
        InvalidInputError: It is none within the precision of typed numbers.
    """
    try:
        T = np.array(rows, np.float64).reshape(4, 4)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(where, quote(rows), "4 x 4 numbers") from error
    if np.isfinite(T).all() and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3):
        left, _, right = np.linalg.svd(T[:3, :3])
        nearest = transform(left @ right, T[:3, 3])
        if is_rigid(nearest) and np.allclose(T[3], (0, 0, 0, 1)):
            return nearest
    raise InvalidInputError(where, quote(rows), "a rotation and a translation as 4 x 4 numbers")


def frame_name(text: object, default: str) -> str:
    """Return a name that a sensor may have, made of one in a file."""
    name = re.sub(r"[^a-z0-9_]+", "_", str(text).lower()).strip("_")[:64]
    return name if re.match(r"[a-z]", name) else default


def unread_keys(data: Mapping[str, Any], read: Collection[str], prefix: str = "") -> list[str]:
    """Return the paths of the keys of a mapping that are not among those that are read."""
    return [f"{prefix}{quote_key(key)}" for key in data if key not in read]


def quote_key(key: object) -> str:
    """Return a key as it can stand in a comment, on one line."""
    return key if isinstance(key, str) and _PLAIN_KEY.fullmatch(key) else quote(key)


def coefficients_of(data: Mapping[str, Any], key: str, where: str, *, is_none: bool) -> list[float]:
    """Return the coefficients of a lens under a key, which only a model without any may lack.

    Raises:
        InvalidInputError: The key is missing, or they are no list of numbers.
    """
    if data.get(key) is None and not is_none:
        raise InvalidInputError(f"{where}.{key}", None, "a value; the key is missing")
    return finite(data.get(key) or (), f"{where}.{key}")


def require_keys(data: Mapping[str, Any], keys: Sequence[str], where: str) -> list[Any]:
    """Return the values of keys.

    Raises:
        InvalidInputError: One is missing; it is named.
    """
    for key in keys:
        if key not in data:
            raise InvalidInputError(f"{where}.{key}", None, "a value; the key is missing")
    return [data[key] for key in keys]
