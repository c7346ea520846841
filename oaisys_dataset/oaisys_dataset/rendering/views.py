"""Whether the views of a world have frames, and differ from each other."""

from __future__ import annotations

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import DIGITAL


def check_views_have_frames(config: SimulationConfig, views: int) -> None:
    """Raise if no camera has an image at any view of a world, which a data set needs.

    Args:
        config: Of the data set.
        views: Number of views of each world.

    Raises:
        InvalidInputError: All cameras begin later, or the render settings leave all images out.
    """
    cameras = [
        camera
        for camera in config.sensors.all_cameras
        if any(map(config.render.renders, camera.modalities))
    ]
    if any(camera.step_offset < views for camera in cameras):
        return
    if not cameras:
        found = sorted(
            {each for camera in config.sensors.all_cameras for each in camera.modalities}
        )
        expected = "one that render.quality and passes do not leave out: data sets need images"
        raise InvalidInputError("sensors.cameras.modalities", found, expected)
    offsets = {camera.name: camera.step_offset for camera in cameras}
    expected = (
        f"a camera with less than {views}, the views of a world: data sets need images, of which"
        " scans alone are none"
    )
    raise InvalidInputError("sensors.cameras.step_offset", offsets, expected)


def check_views_differ(config: SimulationConfig, views: int) -> None:
    """Raise if all views of a world would be the same picture.

    Args:
        config: Of the data set.
        views: Number of views of each world.

    Raises:
        InvalidInputError: Nothing moves the rig, and nothing else changes from view to view.
    """
    if views == 1 or moves_or_changes(config):
        return
    expected = (
        f"a motion, such as hover, because nothing moves the rig, so all {views} views of a world"
        " would be the same; or --views 1"
    )
    raise InvalidInputError("sensors.motion.kind", config.sensors.motion.kind, expected)


def moves_or_changes(config: SimulationConfig) -> bool:
    """Return whether a sample of a configuration may differ from the one before it."""
    if config.sensors.motion.kind != "given" or config.assets.movers or config.extensions:
        return True
    environment, render, faults = config.environment, config.render, config.sensors.faults
    sun = environment.sun_from_time
    changes_light = environment.redraw == "sample" or bool(sun and sun.s_per_sample)
    is_noisy = (
        render.effects.sensor_noise is not None
        or render.camera_look != "clean"
        or faults.of_depth is not None
        or any(map(render.renders, DIGITAL & config.sensors.modalities))
    )
    of_variants = any(each.motion is not None or each.file for each in config.variants)
    return changes_light or is_noisy or of_variants
