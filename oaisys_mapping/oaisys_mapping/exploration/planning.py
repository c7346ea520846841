"""Asks a planner for the next pose, and for the path to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError, quote
from oaisys_core.geometry.poses import check_pose
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.planner import Planner, Situation


class PlannerError(OaisysError):
    """A planner failed, took too long, or asked for what is no pose that it can reach."""


@dataclass(frozen=True)
class Plan:
    """The next view.

    Attributes:
        pose: Of the vehicle.
        path_m: (K, 3) positions from where the vehicle is to there, through known free space.
    """

    pose: Pose
    path_m: FloatArray


def ask_for_plan(planner: Planner, situation: Situation) -> Plan | None:
    """Return the view that a planner, perhaps of another package, asks for; None at the end.

    Raises:
        PlannerError: It failed, or asked for what is no pose, or one to which no way is known to be
            free. The message names the planner.
    """
    try:
        pose = planner.next_pose(situation)
    except Exception as error:
        raise failure_of(planner.name, error) from error
    if pose is None:
        return None
    try:
        pose = _checked(planner, pose)
    except OaisysError as error:
        raise PlannerError(str(error)) from None
    path_m = situation.path_m(np.asarray(pose.position_m))
    if path_m is None:
        position = np.round(pose.position_m, 2).tolist()
        what = f"asked for {position}, to which no way is known to be free"
        raise PlannerError(f"the planner {planner.name!r} {what}")
    return Plan(pose, path_m)


def failure_of(name: str, error: BaseException) -> PlannerError:
    """Return the error that says which planner raised what."""
    what = f"{type(error).__name__}: {quote(str(error))}"
    return PlannerError(f"the planner {name!r} failed: {what}")


def _checked(planner: Planner, pose: object) -> Pose:
    """Return a planner's pose with a unit quaternion.

    Raises:
        InvalidInputError: It is none.
    """
    if not isinstance(pose, Pose):
        raise InvalidInputError(f"planner {planner.name!r}", pose, "a Pose, or None at the end")
    checked = check_pose(pose.position_m, pose.quat_xyzw, f"planner {planner.name!r}: pose")
    return pose if checked == pose else checked
