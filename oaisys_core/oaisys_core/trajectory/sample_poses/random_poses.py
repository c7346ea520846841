"""Motions that draw random poses, with or without a target to look at."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np

from oaisys_core.config.sections.sensing.motion import (
    AroundTargetMotion,
    HoverMotion,
    LookAtMotion,
    RandomMotion,
    TargetConfig,
)
from oaisys_core.geometry.places import waypoints_in_map
from oaisys_core.trajectory.sample_poses.base import (
    Motion,
    MotionStep,
    at_height,
    attitude,
    draw_from,
    looking_at,
    on_ground,
    pose_of,
)
from oaisys_core.types import FloatArray, Pose

MIDDLE_SHARE = 0.9
"""Share of the stage's edges over which a rig hovers by default."""


class Random(Motion):
    """See `RandomMotion`."""

    can_redraw = True

    def __init__(self, config: RandomMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        box = np.array([draw_from(ranges, step.rng) for ranges in self._config.position_m])
        rotation = attitude(self._config, step.rng)
        position_m = at_height(box, self._config, step, step.rng)
        return None if position_m is None else pose_of(position_m, rotation)


class Hover(Motion):
    """See `HoverMotion`."""

    can_redraw = True
    is_lifted = True

    def __init__(self, config: HoverMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        x0, y0, x1, y1 = step.ground.extent_m
        x_m = self._config.x_m or _middle(x0, x1)
        y_m = self._config.y_m or _middle(y0, y1)
        place_m = np.array((draw_from(x_m, step.rng), draw_from(y_m, step.rng), 0.0))
        rotation = attitude(self._config, step.rng)
        position_m = at_height(place_m, self._config, step, step.rng)
        return None if position_m is None else pose_of(position_m, rotation)


class AroundTarget(Motion):
    """See `AroundTargetMotion`."""

    def __init__(self, config: AroundTargetMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval
        self.can_redraw = config.redraw == "sample"

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        config = self._config
        target_m = self._target_m(step)
        rng = step.rng if config.redraw == "sample" else step.batch_rng
        distance_m = draw_from(config.distance_m, rng)
        elevation = radians(draw_from(config.elevation_deg, rng))
        azimuth = radians(draw_from(config.azimuth_deg, rng))
        if target_m is None:
            return None
        level = cos(elevation)
        away = np.array((level * cos(azimuth), level * sin(azimuth), sin(elevation)))
        shell_m = target_m + self._remaining_m(distance_m, step.index) * away
        position_m = at_height(shell_m, config, step, rng)
        return None if position_m is None else _looking(position_m, target_m, config, step)

    def _target_m(self, step: MotionStep) -> FloatArray | None:
        config = self._config
        if config.target_instance is not None:
            return step.locate(config.target_instance)
        target_m = np.array(config.target_m)
        if config.target_lon_lat_deg is not None:
            field = "sensors.motion.target_lon_lat_deg"
            (place_m,) = waypoints_in_map(step.georeference, [config.target_lon_lat_deg], field)
            target_m = np.where(np.isnan(place_m), target_m, place_m)
        if not config.target_above_ground:
            return target_m
        return on_ground(target_m, config.target_m[2], step.ground)

    def _remaining_m(self, distance_m: float, index: int) -> float:
        approach = self._config.approach
        if approach is None:
            return distance_m
        share = min(index / (approach.steps - 1), 1.0)
        return distance_m + share * (approach.distance_m - distance_m)


class LookAt(Motion):
    """See `LookAtMotion`."""

    can_redraw = True

    def __init__(self, config: LookAtMotion) -> None:
        self._config = config
        self.step_interval = config.step_interval

    def pose(self, step: MotionStep) -> Pose | None:
        """See `Motion.pose`."""
        config = self._config
        box = np.array([draw_from(ranges, step.rng) for ranges in config.position_m])
        target_m = self._target_m(box, step)
        position_m = at_height(box, config, step, step.rng)
        if position_m is None or target_m is None:
            return None
        return _looking(position_m, target_m, config, step)

    def _target_m(self, rig_m: FloatArray, step: MotionStep) -> FloatArray | None:
        config = self._config
        target_m = np.array([draw_from(ranges, step.rng) for ranges in config.target_m])
        if config.target_instance is not None:
            return step.locate(config.target_instance)
        if config.target_is_offset:
            target_m += rig_m
        if config.target_above_ground_m is None:
            return target_m
        return on_ground(target_m, config.target_above_ground_m, step.ground)


def _looking(
    position_m: FloatArray, target_m: FloatArray, config: TargetConfig, step: MotionStep
) -> Pose:
    noise_m = config.target_noise_m * step.rng.standard_normal(3)
    return looking_at(position_m, target_m + noise_m, draw_from(config.roll_deg, step.rng))


def _middle(low_m: float, high_m: float) -> tuple[float, float]:
    margin_m = (1 - MIDDLE_SHARE) / 2 * (high_m - low_m)
    return low_m + margin_m, high_m - margin_m
