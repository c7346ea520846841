"""Asks a planner for the next pose, and for the path to it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError, quote
from oaisys_core.geometry.poses import check_pose
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.planner import Planner, Situation


class PlannerError(OaisysError):
    """A planner failed, took too long, or asked for what is no pose that it can reach."""


_LONGEST_ERROR = 1000
"""Characters of what a planner's process says of its failure."""


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
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - another package's code
        text = "an error without a text"
    what = f"{type(error).__name__}: {quote(text)}"
    return PlannerError(f"the planner {name!r} failed: {what}")


def answer_to_json(answer: Plan | PlannerError | None) -> bytes:
    """Return a planner's answer as one line of JSON, without its end; see `answer_from_json`."""
    if answer is None:
        content: dict[str, Any] = {"end": True}
    elif isinstance(answer, PlannerError):
        content = {"error": str(answer)[:_LONGEST_ERROR]}
    else:
        content = {
            "position_m": [float(value) for value in answer.pose.position_m],
            "quat_xyzw": [float(value) for value in answer.pose.quat_xyzw],
            "path_m": np.asarray(answer.path_m, np.float64).tolist(),
        }
    return json.dumps(content).encode()


def answer_from_json(name: str, text: bytes) -> Plan | None:
    """Return the answer of a planner's process, which may be anything; None: the end.

    Args:
        name: Of the planner.
        text: As `answer_to_json` writes it.

    Raises:
        PlannerError: It is one, or no answer.
    """
    try:
        content = json.loads(text)
        if content == {"end": True}:
            return None
        if list(content) == ["error"]:
            raise PlannerError(str(content["error"])[:_LONGEST_ERROR])
        path_m = np.array(content["path_m"], np.float64)
        pose = check_pose(content["position_m"], content["quat_xyzw"])
    except (InvalidInputError, KeyError, OverflowError, RecursionError, TypeError, ValueError):
        raise _no_answer(name, text) from None
    is_path = path_m.ndim == 2 and path_m.shape[1] == 3 and len(path_m) > 0
    if not (is_path and np.isfinite(path_m).all()):
        raise _no_answer(name, text)
    return Plan(pose, path_m)


def _no_answer(name: str, text: bytes) -> PlannerError:
    return PlannerError(f"the planner {name!r} sent {quote(text)}, which is no answer")


def _checked(planner: Planner, pose: object) -> Pose:
    """Return a planner's pose with a unit quaternion.

    Raises:
        InvalidInputError: It is none.
    """
    if not isinstance(pose, Pose):
        raise InvalidInputError(f"planner {planner.name!r}", pose, "a Pose, or None at the end")
    checked = check_pose(pose.position_m, pose.quat_xyzw, f"planner {planner.name!r}: pose")
    return pose if checked == pose else checked
