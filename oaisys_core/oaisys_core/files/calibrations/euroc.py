"""EuRoC's sensor.yaml: a camera or an IMU, with its pose on the body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.calibrations.kalibr import IMU_KEYS
from oaisys_core.files.calibrations.records import (
    FIELD,
    CalibratedCamera,
    Calibration,
    coefficients_of,
    finite,
    frame_name,
    image_size,
    lens,
    mount,
    require_keys,
    rigid,
    unknown_model,
    unread_keys,
)
from oaisys_core.types import FloatArray

NONE = ("none", "")
BROWN_CONRADY = ("radial-tangential", "radtan", "plumb_bob", *NONE)
FISHEYE = ("equidistant", "equi")
CAMERA, IMU = "camera", "imu"
READ = ("sensor_type", "comment", "T_BS", "rate_hz")
CAMERA_KEYS = (
    *("camera_model", "intrinsics", "resolution"),
    *("distortion_model", "distortion_coefficients"),
)
MOUNT_NOTE = "the body's frame is base_link"


def is_sensor(data: Any) -> bool:
    """Return whether YAML data are a sensor of EuRoC."""
    return isinstance(data, Mapping) and "sensor_type" in data and "T_BS" in data


def read_sensor(data: Mapping[str, Any], folder: str) -> Calibration:
    """Return the camera or the IMU of a sensor.yaml.

    Args:
        data: Its content.
        folder: Name of its folder, which is the sensor's, such as ``cam0``.

    Raises:
        InvalidInputError: A value is missing or wrong, it is another sensor, or we lack its model.
    """
    kind = str(data["sensor_type"])
    T_body_sensor = _pose(data["T_BS"])
    rate_hz = None
    if "rate_hz" in data:
        (rate_hz,) = finite([data["rate_hz"]], f"{FIELD}.rate_hz", 1)
    name = frame_name(folder, "camera" if kind == CAMERA else "imu")
    if kind == CAMERA:
        camera = _camera(data, name, T_body_sensor, rate_hz)
        unused = tuple(unread_keys(data, (*READ, *CAMERA_KEYS)))
        return Calibration("EuRoC sensor", (camera,), notes=(MOUNT_NOTE,), unused=unused)
    if kind == IMU:
        values = finite(require_keys(data, IMU_KEYS, FIELD), FIELD, len(IMU_KEYS))
        imu: dict[str, Any] = {"name": name, **dict(zip(IMU_KEYS, values, strict=True))}
        imu |= {} if rate_hz is None else {"rate_hz": rate_hz}
        imu |= mount(T_body_sensor)
        unused = tuple(unread_keys(data, (*READ, *IMU_KEYS)))
        return Calibration("EuRoC sensor", imus=(imu,), notes=(MOUNT_NOTE,), unused=unused)
    raise InvalidInputError(f"{FIELD}.sensor_type", kind, f"{CAMERA} or {IMU}")


def _pose(value: Any) -> FloatArray:
    """Return T_BS, which maps points of the sensor into the body."""
    return rigid(value.get("data") if isinstance(value, Mapping) else value, f"{FIELD}.T_BS")


def _camera(
    data: Mapping[str, Any], name: str, T_body_sensor: FloatArray, rate_hz: float | None
) -> CalibratedCamera:
    model, intrinsics, resolution, distortion = require_keys(data, CAMERA_KEYS[:4], FIELD)
    if model != "pinhole":
        raise unknown_model(model, f"{FIELD}.camera_model")
    fx, fy, cx, cy = finite(intrinsics, f"{FIELD}.intrinsics", 4)
    width, height = finite(resolution, f"{FIELD}.resolution", 2)
    kind = str(distortion or "")
    if kind not in (*FISHEYE, *BROWN_CONRADY):
        raise unknown_model(kind, f"{FIELD}.distortion_model")
    where = f"{FIELD}.distortion_coefficients"
    coefficients = coefficients_of(data, CAMERA_KEYS[4], FIELD, is_none=kind in NONE)
    return CalibratedCamera(
        name,
        image_size(width, height, f"{FIELD}.resolution"),
        (fx, fy),
        (cx, cy),
        *lens(coefficients, where, is_fisheye=kind in FISHEYE),
        T_base_optical=T_body_sensor,
        rate_hz=rate_hz,
    )
