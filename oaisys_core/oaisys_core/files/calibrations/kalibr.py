"""Kalibr's camchain.yaml and imu.yaml."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
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
from oaisys_core.geometry import T_LINK_OPTICAL, invert
from oaisys_core.types import FloatArray

IMU_KEYS = (
    "accelerometer_noise_density",
    "accelerometer_random_walk",
    "gyroscope_noise_density",
    "gyroscope_random_walk",
)
MOST_DISAGREEMENT = 1e-2
"""Largest difference, in metres or of a rotation matrix, of T_cam_imu from what T_cn_cnm1 gives."""
CAMERA_KEYS = (
    *("camera_model", "intrinsics", "resolution", "distortion_model"),
    *("distortion_coeffs", "T_cam_imu", "T_cn_cnm1", "timeshift_cam_imu"),
    *("rostopic", "cam_overlaps"),
)
"""Keys of a camera: those that are read, a topic, and which cameras see the same."""
IMU_READ = (*IMU_KEYS, "update_rate", "T_i_b", "rostopic")
FISHEYE, BROWN_CONRADY = ("equidistant", "equi"), ("radtan", "none")
_CAMERA = re.compile(r"cam([0-9]{1,9})")


def is_camchain(data: Any) -> bool:
    """Return whether YAML data are a chain of cameras."""
    return isinstance(data, Mapping) and any(_CAMERA.fullmatch(str(key)) for key in data)


def is_imu(data: Any) -> bool:
    """Return whether YAML data describe IMUs: one, or several as ``imu0`` and so on."""
    if not isinstance(data, Mapping):
        return False
    return IMU_KEYS[0] in data or (
        isinstance(data.get("imu0"), Mapping) and IMU_KEYS[0] in data["imu0"]
    )


def read_camchain(data: Mapping[str, Any]) -> Calibration:
    """Return the cameras of a chain; where it was calibrated with an IMU, that is ``base_link``.

    ``T_cam_imu`` maps points of the IMU into the camera, ``T_cn_cnm1`` those of the camera before.
    Without an IMU the first camera is at ``base_link``, looking along its x axis.

    Raises:
        InvalidInputError: A value is missing or wrong, or we lack the model.
    """
    names = sorted((key for key in data if _CAMERA.fullmatch(str(key))), key=_number)
    cameras: list[CalibratedCamera] = []
    before: FloatArray | None = None
    has_imu = any("T_cam_imu" in data[name] for name in names if isinstance(data[name], Mapping))
    for name in names:
        where = f"{FIELD}.{name}"
        entry = data[name]
        if not isinstance(entry, Mapping):
            raise InvalidInputError(where, entry, "a mapping")
        direct = chained = None
        if "T_cam_imu" in entry:
            direct = invert(rigid(entry["T_cam_imu"], f"{where}.T_cam_imu"))
        if before is not None and "T_cn_cnm1" in entry:
            chained = before @ invert(rigid(entry["T_cn_cnm1"], f"{where}.T_cn_cnm1"))
        if direct is not None and chained is not None:
            _check_agreement(direct, chained, f"{where}.T_cam_imu")
        before = chained if direct is None else direct
        if before is None and not has_imu and name == names[0]:
            before = T_LINK_OPTICAL
        if before is None:
            raise InvalidInputError(f"{where}.T_cn_cnm1", None, "the pose to the camera before")
        cameras.append(_camera(name, entry, before, where))
    base = "the IMU's frame is base_link" if has_imu else f"{names[0]} is at base_link"
    notes = [base]
    if any(entry.get("timeshift_cam_imu") for entry in (data[name] for name in names)):
        notes.append("timeshift_cam_imu is not used: stamps are exact")
    unused = unread_keys(data, names)
    for name in names:
        unused += unread_keys(data[name], CAMERA_KEYS, f"{name}.")
    return Calibration("Kalibr camchain", tuple(cameras), notes=tuple(notes), unused=tuple(unused))


def _check_agreement(T_imu_camera: FloatArray, chained: FloatArray, where: str) -> None:
    """Raise if the two ways to a camera, by the IMU and by the camera before, differ."""
    if abs(chained - T_imu_camera).max() > MOST_DISAGREEMENT:
        received = invert(T_imu_camera).round(4).tolist()
        expected = f"what T_cn_cnm1 gives: {invert(chained).round(4).tolist()}"
        raise InvalidInputError(where, received, expected)


def read_imu(data: Mapping[str, Any]) -> Calibration:
    """Return the IMUs of a file with their noise, whose names and units ours share."""
    entries = (
        {"imu": data}
        if IMU_KEYS[0] in data
        else {str(key): value for key, value in data.items() if re.fullmatch(r"imu\d+", str(key))}
    )
    imus, unused = [], [] if IMU_KEYS[0] in data else unread_keys(data, list(entries))
    for name, entry in entries.items():
        where = f"{FIELD}.{name}"
        values = finite(require_keys(entry, IMU_KEYS, where), where, len(IMU_KEYS))
        imu: dict[str, Any] = {"name": name, **dict(zip(IMU_KEYS, values, strict=True))}
        if "update_rate" in entry:
            imu["rate_hz"] = finite([entry["update_rate"]], f"{where}.update_rate", 1)[0]
        if "T_i_b" in entry:  # from the body to this IMU
            imu |= mount(invert(rigid(entry["T_i_b"], f"{where}.T_i_b")))
        imus.append(imu)
        unused += unread_keys(entry, IMU_READ, "" if entry is data else f"{name}.")
    notes = ("an IMU without T_i_b is at base_link",)
    return Calibration("Kalibr imu", imus=tuple(imus), notes=notes, unused=tuple(unused))


def _number(name: object) -> int:
    return int(str(name).removeprefix("cam"))


def _camera(
    name: str, entry: Mapping[str, Any], T_base_optical: FloatArray, where: str
) -> CalibratedCamera:
    model, intrinsics, size, distortion_model = require_keys(entry, CAMERA_KEYS[:4], where)
    if model != "pinhole":
        raise unknown_model(model, f"{where}.camera_model")
    fx, fy, cx, cy = finite(intrinsics, f"{where}.intrinsics", 4)
    width, height = finite(size, f"{where}.resolution", 2)
    kind = str(distortion_model)
    if kind not in (*FISHEYE, *BROWN_CONRADY):
        raise unknown_model(kind, f"{where}.distortion_model")
    coefficients = coefficients_of(entry, CAMERA_KEYS[4], where, is_none=kind == "none")
    distortion, fisheye = lens(
        coefficients, f"{where}.distortion_coeffs", is_fisheye=kind in FISHEYE
    )
    return CalibratedCamera(
        frame_name(name, name),
        image_size(width, height, f"{where}.resolution"),
        (fx, fy),
        (cx, cy),
        distortion,
        fisheye,
        T_base_optical,
    )
