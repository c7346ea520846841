"""The lamps of an environment: which of them are on, where, and what metadata may change."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians

import numpy as np

from oaisys_core.color import linear
from oaisys_core.config.sections.lamps import LampConfig
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.scene import Ground
from oaisys_core.scene.lamps import Lamp, Vector
from oaisys_core.world.module import Metadata, require

RADIUS_M = 0.05
CONE_DEG = 60.0
CONE_SOFTNESS = 0.15
EDGE_M = 1.0
"""Values of keys that are None."""

DOWN: Vector = (0.0, 0.0, -1.0)
AHEAD: Vector = (1.0, 0.0, 0.0)

VERTICAL = 1e-6
"""Horizontal part of a unit vector below which it counts as vertical."""


def lamps_that_are_on(
    configs: Mapping[str, LampConfig], strengths_w: Mapping[str, float], ground: Ground | None
) -> tuple[Lamp, ...]:
    """Return the lamps that shine, sorted by name, so that the order of changes does not matter.

    Args:
        configs: All lamps by name.
        strengths_w: Their strengths, as they were drawn.
        ground: Of the stage.

    Raises:
        InvalidInputError: The height of a lamp outside the stage is relative to the ground.
    """
    return tuple(
        _make(name, config, strengths_w[name], ground)
        for name, config in sorted(configs.items())
        if config.enabled and strengths_w[name] > 0
    )


def check_changes(lamps: Mapping[str, LampConfig], metadata: Metadata) -> None:
    """Raise if metadata of the environment change a lamp that does not exist.

    Args:
        lamps: The lamps before the change.
        metadata: May add lamps, which need a position.

    Raises:
        InvalidInputError: Names the lamp and those that exist.
    """
    changes = (metadata or {}).get("lamps")
    if not isinstance(changes, Mapping):
        return
    for name, values in changes.items():
        if name not in lamps and isinstance(values, Mapping) and "position_m" not in values:
            expected = f"{one_of(lamps, name)}, or position_m for a new lamp"
            raise InvalidInputError(f"metadata.environment.lamps.{name}", values, expected)


def _make(name: str, config: LampConfig, strength_w: float, ground: Ground | None) -> Lamp:
    forward = _unit(config.direction or (DOWN if config.frame == "map" else AHEAD))
    red, green, blue = linear(config.color_srgb).tolist()
    return Lamp(
        name=name,
        kind=config.kind,
        frame=config.frame,
        position_m=_position(name, config, ground),
        forward=forward,
        right=_right_of(forward),
        strength_w=strength_w,
        color=(red, green, blue),
        radius_m=RADIUS_M if config.radius_m is None else config.radius_m,
        cone_rad=radians(config.cone_deg or CONE_DEG),
        cone_softness=CONE_SOFTNESS if config.cone_softness is None else config.cone_softness,
        width_m=config.width_m or EDGE_M,
        height_m=config.height_m or EDGE_M,
    )


def _position(name: str, config: LampConfig, ground: Ground | None) -> Vector:
    x, y, z = config.position_m
    if not config.on_ground:
        return (x, y, z)
    ground_m = float(require(ground).height_at([(x, y)])[0])
    if not np.isfinite(ground_m):
        path = f"environment.lamps.{name}.position_m"
        raise InvalidInputError(path, [x, y, z], "a position on the stage")
    return (x, y, z + ground_m)


def _right_of(forward: Vector) -> Vector:
    """Return the horizontal unit vector to the right of a direction; +x if that is vertical."""
    x, y, _ = forward
    return _unit((y, -x, 0.0)) if np.hypot(x, y) > VERTICAL else (1.0, 0.0, 0.0)


def _unit(vector: Vector) -> Vector:
    x, y, z = (np.array(vector) / np.linalg.norm(vector)).tolist()
    return (x, y, z)
