"""Motions without time: the rig's pose from a batch's seed and a sample's id."""

from __future__ import annotations

from collections.abc import Sequence

from oaisys_core.config.sections.sensing.motion import (
    AnyMotion,
    AroundTargetMotion,
    CsvMotion,
    GivenMotion,
    GridMotion,
    HoverMotion,
    LookAtMotion,
    RandomMotion,
)
from oaisys_core.trajectory.sample_poses.base import Motion
from oaisys_core.trajectory.sample_poses.paths import Csv, Grid, Spline
from oaisys_core.trajectory.sample_poses.random_poses import AroundTarget, Hover, LookAt, Random
from oaisys_core.types import SensorInfo

__all__ = ["Motion", "make_motion"]


def make_motion(config: AnyMotion, sensors: Sequence[SensorInfo]) -> Motion | None:
    """Return the motion that a configuration describes, or None if the rig does not move.

    Raises:
        InvalidInputError: A file of poses cannot be read, or a camera does not exist.
    """
    if isinstance(config, GivenMotion):
        return None
    if isinstance(config, CsvMotion):
        return Csv(config, sensors)
    if isinstance(config, RandomMotion):
        return Random(config)
    if isinstance(config, HoverMotion):
        return Hover(config)
    if isinstance(config, AroundTargetMotion):
        return AroundTarget(config)
    if isinstance(config, LookAtMotion):
        return LookAt(config)
    if isinstance(config, GridMotion):
        return Grid(config, sensors)
    return Spline(config)
