"""Whether the views of a world differ from each other."""

from __future__ import annotations

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import DIGITAL


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
