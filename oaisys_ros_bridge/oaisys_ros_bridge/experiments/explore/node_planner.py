"""A planner that is a program of its own: it commands views over ROS, and is watched."""

from __future__ import annotations

import os
import shlex
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oaisys_core.errors import DeadlineExceededError, InvalidInputError, OaisysError, RenderError
from oaisys_core.files.names import NAME_EXPECTED, is_name
from oaisys_core.system.ending.descendants import command_with_descendants
from oaisys_core.system.processes import ManagedProcess
from oaisys_core.types import Pose
from oaisys_mapping.exploration.planners import BUILT_IN_PLANNERS
from oaisys_ros_bridge.experiments.explore.exploration import (
    Exploration,
    ExplorationLimits,
    reason_to_end,
)
from oaisys_ros_bridge.experiments.explore.trajectory_client import TrajectoryClient
from oaisys_ros_bridge.experiments.planner_client import ReceivedView

VIEW_TIMEOUT_S = 300.0
"""Of a view that is requested, from its request."""

IMAGES_TIMEOUT_S = 60.0
"""Of the images of a view that is announced, which was rendered before."""


@dataclass(frozen=True)
class NodePlanner:
    """A program that plans.

    Attributes:
        name: In the report.
        command: The program and its arguments.
        silence_s: It is done once it has commanded no view for so long.
    """

    name: str
    command: tuple[str, ...]
    silence_s: float


def node_planner(text: str, silence_s: float) -> NodePlanner:
    """Return the planner that an option ``NAME=COMMAND`` names.

    Raises:
        InvalidInputError: It has no such form, a built-in planner's name, or no program to run.
    """
    name, _, command = text.partition("=")
    name = name.strip()
    try:
        words = tuple(shlex.split(command))
    except ValueError as error:
        raise InvalidInputError("--node", text, f"NAME=COMMAND ({error})") from None
    if not name or not words:
        raise InvalidInputError("--node", text, "NAME=COMMAND")
    if name in BUILT_IN_PLANNERS or "," in name:
        raise InvalidInputError("--node", name, "a name without comma that no built-in planner has")
    if not is_name(name):  # of its log
        raise InvalidInputError("--node", name, NAME_EXPECTED)
    if shutil.which(words[0]) is None:
        raise InvalidInputError("--node", words[0], "a program that can be run")
    return NodePlanner(name, words, silence_s)


def watch(
    planner: NodePlanner,
    client: TrajectoryClient,
    start: Pose,
    limits: ExplorationLimits,
    log: Path,
    goes_on: Callable[[Exploration], bool],
) -> Exploration:
    """Render from ``start``, then let the program command views until it or a limit ends it.

    It is done when it exits with code 0, or is silent after its first view. The way between two
    views counts as straight; what the bridge refused is in its log.

    Args:
        planner: The program; it runs in this process's ROS domain.
        client: Receives what is rendered.
        start: Of the rig; the program learns it from odometry and TF.
        limits: When to end.
        log: The program's output.
        goes_on: Called after every view; returns whether to go on.

    Returns:
        What was explored until then, also where the first view was refused, the program failed or
        commanded no view, or a view was not received.
    """
    result = Exploration()
    try:
        view, _ = client.view_by_service(start, VIEW_TIMEOUT_S)
    except (DeadlineExceededError, RenderError) as error:
        result.end(reason_to_end(error, result, 1), failed=True)
        return result
    _add(result, view, start)
    if not goes_on(result):
        result.end("coverage")
        return result
    result.end(f"{limits.views} views")
    if limits.views == 1:
        return result
    command = command_with_descendants(planner.command)
    with ManagedProcess(planner.name, command, log, os.environ, logs_output=True) as process:
        try:
            _follow(planner, process, client, limits, goes_on, result)
        except OaisysError as error:
            result.end(str(error), failed=True)
    client.replace_commands(result.poses[-1])
    return result


def _follow(
    planner: NodePlanner,
    process: ManagedProcess,
    client: TrajectoryClient,
    limits: ExplorationLimits,
    goes_on: Callable[[Exploration], bool],
    result: Exploration,
) -> None:
    """Add the views that a program commands, and note why they ended.

    Raises:
        OaisysError: A view was not received, or the program failed.
    """
    while len(result.poses) < limits.views:
        asked_s = time.monotonic()
        found = client.wait_for_commanded_view(
            planner.silence_s, lambda: process.exit_code is not None, IMAGES_TIMEOUT_S
        )
        if found is None:
            _note_end(planner, process, result)
            return
        view, pose = found
        if _length_m(result, pose) > limits.path_m:
            result.end(f"{limits.path_m:g} m of path")
            return
        result.plan_s.append(max(time.monotonic() - asked_s - view.render_s, 0.0))
        _add(result, view, pose)
        if not goes_on(result):
            result.end("coverage")
            return


def _note_end(planner: NodePlanner, process: ManagedProcess, result: Exploration) -> None:
    """Note why a program commands no more views.

    Raises:
        OaisysError: It has ended with another exit code than 0.
    """
    if process.exit_code is None:
        reason = f"{planner.name} commanded no view for {planner.silence_s:g} s"
        result.end(reason, failed=len(result.poses) == 1)
        return
    if process.exit_code != 0:
        process.check()
    result.end("exit code 0")


def _length_m(result: Exploration, pose: Pose) -> float:
    """Return the length flown up to a next pose."""
    step_m = np.subtract(pose.position_m, result.poses[-1].position_m)
    return result.path_m[-1] + float(np.linalg.norm(step_m))


def _add(result: Exploration, view: ReceivedView, pose: Pose) -> None:
    result.path_m.append(_length_m(result, pose) if result.poses else 0.0)
    result.poses.append(pose)
    result.views.append(view)
