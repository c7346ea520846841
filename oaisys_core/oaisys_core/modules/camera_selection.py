"""Which cameras render a sample, and which of their modalities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from oaisys_core.config.sections.sensors import CameraConfig
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.module import World
from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FrameName


def due_cameras(
    world: World,
    configs: Sequence[CameraConfig],
    modalities: Sequence[str],
    sensors: Sequence[str],
) -> list[PlacedCamera]:
    """Return the cameras that render the world's sample, each with the modalities it renders.

    If sensors or modalities are named, exactly these render, whatever their intervals; otherwise
    those that are due by their intervals, which may be none.

    Args:
        world: Its cameras, and the id of its sample.
        configs: The configuration of each camera.
        modalities: Names; empty for all.
        sensors: Names; empty for all.
    """
    cameras = select(world.cameras, modalities, sensors)
    if not modalities and not sensors:
        by_name = {config.name: config for config in configs}
        cameras = tuple(_due(camera, by_name[camera.name], world.sample_id) for camera in cameras)
    return [camera for camera in cameras if camera.modalities]


def cameras_of(cameras: Sequence[PlacedCamera], frames: Sequence[FrameName]) -> list[PlacedCamera]:
    """Return the cameras that render exactly these frames.

    Raises:
        InvalidInputError: There is no such sensor, or it has no such modality.
    """
    wanted: dict[str, set[str]] = {}
    for frame in frames:
        select(cameras, (frame.modality,), (frame.sensor,))
        wanted.setdefault(frame.sensor, set()).add(frame.modality)
    return [
        replace(camera, modalities=tuple(m for m in camera.modalities if m in wanted[camera.name]))
        for camera in cameras
        if camera.name in wanted
    ]


def select(
    cameras: Sequence[PlacedCamera], modalities: Sequence[str], sensors: Sequence[str]
) -> tuple[PlacedCamera, ...]:
    """Return the named cameras with the named modalities; no names mean all.

    Raises:
        InvalidInputError: There is no such sensor or modality, or the named sensors have none of
            the named modalities.
    """
    names = [camera.name for camera in cameras]
    for sensor in sensors:
        if sensor not in names:
            raise InvalidInputError("sensors", sensor, one_of(names, sensor))
    chosen = [camera for camera in cameras if not sensors or camera.name in sensors]
    _check_modalities(cameras, modalities)
    if not any(set(modalities) & set(camera.modalities) for camera in chosen):
        _check_modalities(chosen, modalities)
    return tuple(
        replace(c, modalities=tuple(m for m in c.modalities if not modalities or m in modalities))
        for c in chosen
    )


def _check_modalities(cameras: Sequence[PlacedCamera], modalities: Sequence[str]) -> None:
    """Refuse a modality that none of the cameras has."""
    offered = {modality for camera in cameras for modality in camera.modalities}
    for modality in modalities:
        if modality not in offered:
            known = ", ".join(sorted(offered))
            raise InvalidInputError("modalities", modality, f"one of {known}")


def _due(camera: PlacedCamera, config: CameraConfig, sample_id: int) -> PlacedCamera:
    """Return a camera with the modalities that its intervals let it render at a sample."""
    turn, rest = divmod(sample_id - 1 - config.step_offset, config.step_interval)
    if turn < 0 or rest:
        return replace(camera, modalities=())
    intervals = config.modality_intervals
    chosen = tuple(m for m in camera.modalities if turn % intervals.get(m, 1) == 0)
    return replace(camera, modalities=chosen)
