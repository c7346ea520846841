"""The optics of cameras: conversion from the configuration, and changes by metadata."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians
from typing import Any

from oaisys_core import geometry
from oaisys_core.config.sections.sensors import CameraConfig, OpticsConfig, optics_bounds_px
from oaisys_core.errors import InvalidInputError
from oaisys_core.modules.overrides import overridden
from oaisys_core.scene import Lens
from oaisys_core.types import SensorInfo


def changed_cameras(
    cameras: tuple[CameraConfig, ...], changes: Any, path: str
) -> tuple[CameraConfig, ...]:
    """Return the cameras with changed fields of `OpticsConfig`.

    Args:
        cameras: The cameras before the changes.
        changes: Mapping of camera names to new values by field, from metadata.
        path: Path of ``changes`` below ``metadata``.

    Raises:
        InvalidInputError: There is no such camera or field, or a value is invalid.
    """
    names = [camera.name for camera in cameras]
    if not isinstance(changes, Mapping):
        raise InvalidInputError(f"metadata.{path}", changes, "a mapping by camera name")
    for name, values in changes.items():
        if name not in names:
            known = ", ".join(names)
            raise InvalidInputError(f"metadata.{path}.{name}", values, f"one of {known}")
        _check_keys(f"{path}.{name}", values)
        _check_reach(cameras[names.index(name)], f"{path}.{name}", values)
    return tuple(
        overridden(camera, changes.get(camera.name), f"{path}.{camera.name}") for camera in cameras
    )


def lens_of(camera: CameraConfig) -> Lens | None:
    """Return the lens of a camera for the scene."""
    lens = camera.lens
    if lens is None:
        return None
    return Lens(
        focus_distance_m=lens.focus_distance_m,
        f_number=lens.f_number,
        blades=lens.blades,
        blade_rotation_rad=radians(lens.blade_rotation_deg),
        ratio=lens.ratio,
    )


def sensor_info(camera: CameraConfig, baseline_m: float) -> SensorInfo:
    """Return a camera as clients see it; ``baseline_m`` is 0 except for right stereo cameras."""
    mount = geometry.checked_pose(
        camera.mount_position_m, camera.mount_quat_xyzw, f"sensors.cameras.{camera.name}.mount"
    )
    T_base_camera = geometry.pose_to_matrix(mount) @ geometry.T_LINK_OPTICAL
    modalities = tuple(camera.modalities)
    return SensorInfo(camera.name, camera.intrinsics, T_base_camera, modalities, baseline_m)


def _check_keys(path: str, values: Any) -> None:
    known = sorted(OpticsConfig.model_fields)
    if not isinstance(values, Mapping):
        raise InvalidInputError(f"metadata.{path}", values, f"a mapping of {', '.join(known)}")
    for key, value in values.items():
        if key not in known:
            expected = f"one of the keys {', '.join(known)}"
            raise InvalidInputError(f"metadata.{path}.{key}", value, expected)


def _check_reach(camera: CameraConfig, path: str, values: Mapping[str, Any]) -> None:
    """Raise if an entry of the camera matrix is out of bounds, with its own path."""
    for key, (least_px, most_px) in optics_bounds_px(camera.width_px).items():
        value = values.get(key)
        if isinstance(value, int | float) and not least_px <= value <= most_px:
            expected = f"{least_px:g} to {most_px:g} for an image {camera.width_px} pixels wide"
            raise InvalidInputError(f"metadata.{path}.{key}", value, expected)
