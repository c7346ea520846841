"""The cameras of a rig: what metadata changes of them, and where they are; which sensors render."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import radians
from typing import Any

from oaisys_core import geometry
from oaisys_core.config.sections.sensing.cameras import CameraConfig, OpticsConfig, optics_bounds_px
from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.errors import InvalidInputError, one_of, one_of_keys
from oaisys_core.scene import Lens, PlacedCamera, PlacedLidar, PoseAtTime
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FrameName, Pose, SensorInfo
from oaisys_core.world.module import override
from oaisys_core.world.modules.lidars import ConstantVelocity, sensor_poses

Cameras = tuple[CameraConfig, ...]

PlacedSensor = PlacedCamera | PlacedLidar


def change_cameras(cameras: Cameras, changes: Any, path: str) -> Cameras:
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
            raise InvalidInputError(f"metadata.{path}.{name}", values, one_of(names, name))
        _check_keys(f"{path}.{name}", values)
        _check_reach(cameras[names.index(name)], f"{path}.{name}", values)
    return tuple(
        override(camera, changes.get(camera.name), f"{path}.{camera.name}") for camera in cameras
    )


def sensor_info(camera: CameraConfig, baseline_m: float) -> SensorInfo:
    """Return a camera as clients see it; ``baseline_m`` is 0 except for right stereo cameras."""
    mount = geometry.check_pose(
        camera.mount_position_m, camera.mount_quat_xyzw, f"sensors.cameras.{camera.name}.mount"
    )
    T_base_camera = geometry.pose_to_matrix(mount) @ geometry.T_LINK_OPTICAL
    modalities = tuple(camera.modalities)
    return SensorInfo(camera.name, camera.intrinsics, T_base_camera, modalities, baseline_m)


def place_cameras(
    cameras: Cameras,
    sensors: Sequence[SensorInfo],
    rig_pose: Pose,
    baselines_m: Mapping[str, float],
) -> tuple[PlacedCamera, ...]:
    """Return the cameras in ``map``, each with all its modalities.

    Args:
        cameras: Their configuration.
        sensors: Their descriptions.
        rig_pose: Pose of the rig.
        baselines_m: Baseline of its pair by the name of each stereo camera.
    """
    T_map_base = geometry.pose_to_matrix(rig_pose)
    return tuple(
        PlacedCamera(
            name=sensor.name,
            intrinsics=sensor.intrinsics,
            T_map_camera=T_map_base @ sensor.T_base_camera,
            modalities=sensor.modalities,
            lens=_lens(camera),
            shutter_share=camera.shutter_share,
            stereo_baseline_m=baselines_m.get(sensor.name, 0.0),
            readout_s=camera.readout_s,
            exposure_s=camera.exposure_s,
            image_sensor=camera.image_sensor.image_sensor,
        )
        for sensor, camera in zip(sensors, cameras, strict=True)
    )


def with_previous_poses(
    placed: Sequence[PlacedCamera],
    cameras: Cameras,
    sensors: Sequence[SensorInfo],
    last_rig_poses: Mapping[str, Pose],
) -> tuple[PlacedCamera, ...]:
    """Return the cameras with their poses when they last rendered, and their motion since then.

    Args:
        placed: The cameras that render.
        cameras: The configuration of all cameras of the rig.
        sensors: Their descriptions.
        last_rig_poses: By camera name, the pose of the rig when that camera last rendered.
    """
    mounts = {sensor.name: sensor.T_base_camera for sensor in sensors}
    rates_hz = {camera.name: camera.rate_hz for camera in cameras}
    moving = []
    for camera in placed:
        before = last_rig_poses.get(camera.name)
        if before is not None:
            T_map_previous = geometry.pose_to_matrix(before) @ mounts[camera.name]
            camera = replace(camera, T_map_previous=T_map_previous)  # noqa: PLW2901
            if camera.readout_s or camera.exposure_s:
                motion = ConstantVelocity.between(
                    T_map_previous, camera.T_map_camera, 1 / rates_hz[camera.name]
                )
                camera = replace(camera, pose_at=motion)  # noqa: PLW2901
        moving.append(camera)
    return tuple(moving)


def following_cameras(
    placed: Sequence[PlacedCamera], sensors: Sequence[SensorInfo], T_map_base: PoseAtTime
) -> tuple[PlacedCamera, ...]:
    """Return the cameras, moving with the rig during readout and exposure.

    Args:
        placed: The cameras that render.
        sensors: The descriptions of all cameras of the rig.
        T_map_base: Poses of the rig at times since the sample's own.
    """
    mounts = {sensor.name: sensor.T_base_camera for sensor in sensors}
    return tuple(
        replace(camera, pose_at=partial(sensor_poses, T_map_base, mounts[camera.name]))
        if camera.readout_s or camera.exposure_s
        else camera
        for camera in placed
    )


def due_sensors(
    placed: Sequence[PlacedSensor],
    configs: Sequence[CameraConfig | LidarConfig],
    sample_id: int,
    modalities: Sequence[str],
    sensors: Sequence[str],
    settings: RenderSettings,
) -> list[PlacedSensor]:
    """Return the sensors that render a sample, each with the modalities it renders.

    If sensors or modalities are named, exactly these render, whatever their intervals; otherwise
    those that are due by their intervals, which may be none, without what the settings leave out.

    Raises:
        InvalidInputError: See `select`; or the settings leave out what is named.
    """
    chosen = select(placed, modalities, sensors)
    if not modalities and not sensors:
        by_name = {config.name: config for config in configs}
        chosen = tuple(_due(sensor, by_name[sensor.name], sample_id) for sensor in chosen)
    rendered = [_without_excluded(sensor, settings) for sensor in chosen]
    _check_rendered(chosen, rendered, modalities, sensors, settings.quality)
    return [sensor for sensor in rendered if sensor.modalities]


def sensors_of(placed: Sequence[PlacedSensor], frames: Sequence[FrameName]) -> list[PlacedSensor]:
    """Return the sensors that render exactly these frames.

    Raises:
        InvalidInputError: There is no such sensor, or it has no such modality.
    """
    wanted: dict[str, set[str]] = {}
    for frame in frames:
        select(placed, (frame.modality,), (frame.sensor,))
        wanted.setdefault(frame.sensor, set()).add(frame.modality)
    return [
        replace(sensor, modalities=tuple(m for m in sensor.modalities if m in wanted[sensor.name]))
        for sensor in placed
        if sensor.name in wanted
    ]


def select(
    placed: Sequence[PlacedSensor], modalities: Sequence[str], sensors: Sequence[str]
) -> tuple[PlacedSensor, ...]:
    """Return the named sensors with the named modalities; no names mean all.

    Raises:
        InvalidInputError: There is no such sensor; none of them has a named modality; or a named
            sensor has none of them.
    """
    names = [sensor.name for sensor in placed]
    for name in sensors:
        if name not in names:
            raise InvalidInputError("sensors", name, one_of(names, name))
    chosen = [sensor for sensor in placed if not sensors or sensor.name in sensors]
    offered = {modality for sensor in chosen for modality in sensor.modalities}
    of = f", which {_in_words(sensors)} can render" if sensors else ""
    for modality in modalities:
        if modality not in offered:
            raise InvalidInputError("modalities", modality, one_of(offered, modality) + of)
    if not modalities:
        return tuple(chosen)
    selected = tuple(
        replace(s, modalities=tuple(m for m in s.modalities if m in modalities)) for s in chosen
    )
    for sensor, before in zip(selected, chosen, strict=True):
        if sensors and not sensor.modalities:
            expected = (
                f"a sensor with {_in_words(modalities)}; it has {_in_words(before.modalities)}"
            )
            raise InvalidInputError("sensors", sensor.name, expected)
    return selected


def _without_excluded(sensor: PlacedSensor, settings: RenderSettings) -> PlacedSensor:
    """Return a sensor without the images that the settings leave out."""
    if isinstance(sensor, PlacedLidar):
        return sensor
    kept = tuple(filter(settings.renders, sensor.modalities))
    return sensor if kept == sensor.modalities else replace(sensor, modalities=kept)


def _check_rendered(
    chosen: Sequence[PlacedSensor],
    rendered: Sequence[PlacedSensor],
    modalities: Sequence[str],
    sensors: Sequence[str],
    quality: str,
) -> None:
    """Refuse a named modality or sensor of which the render settings leave nothing."""
    left = {modality for sensor in rendered for modality in sensor.modalities}
    why = f"neither quality ({quality}) nor passes of render leave out"
    for modality in modalities:
        if modality not in left:
            raise InvalidInputError("modalities", modality, f"one that {why}")
    for sensor, before in zip(rendered, chosen, strict=True):
        if sensors and not sensor.modalities:
            expected = f"a sensor with images that {why}; it has {_in_words(before.modalities)}"
            raise InvalidInputError("sensors", sensor.name, expected)


def _in_words(names: Sequence[str]) -> str:
    return ", ".join(names)


def _due(sensor: PlacedSensor, config: CameraConfig | LidarConfig, sample_id: int) -> PlacedSensor:
    """Return a sensor with the modalities that its intervals let it render at a sample."""
    turn, rest = divmod(sample_id - 1 - config.step_offset, config.step_interval)
    if turn < 0 or rest:
        return replace(sensor, modalities=())
    intervals = config.modality_intervals if isinstance(config, CameraConfig) else {}
    chosen = tuple(m for m in sensor.modalities if turn % intervals.get(m, 1) == 0)
    return replace(sensor, modalities=chosen)


def _lens(camera: CameraConfig) -> Lens | None:
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


def _check_keys(path: str, values: Any) -> None:
    known = sorted(OpticsConfig.model_fields)
    if not isinstance(values, Mapping):
        raise InvalidInputError(f"metadata.{path}", values, f"a mapping of {', '.join(known)}")
    for key, value in values.items():
        if key not in known:
            raise InvalidInputError(f"metadata.{path}.{key}", value, one_of_keys(known, key))


def _check_reach(camera: CameraConfig, path: str, values: Mapping[str, Any]) -> None:
    """Raise if an entry of the camera matrix is out of bounds, with its own path."""
    for key, (least_px, most_px) in optics_bounds_px(camera.width_px).items():
        value = values.get(key)
        if isinstance(value, int | float) and not least_px <= value <= most_px:
            expected = f"{least_px:g} to {most_px:g} for an image {camera.width_px} pixels wide"
            raise InvalidInputError(f"metadata.{path}.{key}", value, expected)
