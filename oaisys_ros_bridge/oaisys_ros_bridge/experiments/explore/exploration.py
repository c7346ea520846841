"""The exploration loop: renders a view, maps its depth, and asks a planner for the next pose."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from oaisys_core.errors import DeadlineExceededError, OaisysError, RenderError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import Planner, Situation, Vehicle
from oaisys_mapping.exploration.planning import Plan, PlannerError, ask_for_plan
from oaisys_mapping.rectification import rectify, rectify_camera
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.mapper.fusion import DepthFrame

MAX_REFUSALS = 5
"""An exploration ends when the simulator refuses this many poses in a row."""


@dataclass(frozen=True)
class ExplorationLimits:
    """When an exploration ends.

    Attributes:
        views: Most views.
        path_m: Longest path flown.
    """

    views: int
    path_m: float = np.inf


@dataclass
class Exploration:
    """What a vehicle has flown and observed.

    Attributes:
        poses: Of the vehicle, one per view.
        path_m: Length of the path flown up to each view.
        plan_s: How long the planner took for each next pose.
        views: What was received.
        refused: How many poses the simulator refused.
        ended: Why it ended.
        failed: Whether it ended because the planner failed, or the first view did.
    """

    poses: list[Pose] = field(default_factory=list)
    path_m: list[float] = field(default_factory=list)
    plan_s: list[float] = field(default_factory=list)
    views: list[ReceivedView] = field(default_factory=list)
    refused: int = 0
    ended: str = ""
    failed: bool = False

    def end(self, reason: str, *, failed: bool = False) -> None:
        """Note why it ended."""
        self.ended, self.failed = reason, failed


NextPlan = Callable[[Vehicle, OccupancyMap, Sequence[Pose]], Plan | None]
"""From a vehicle, the map of what it has observed and its poses so far to the next view."""


def plans_of(planner: Planner, rng: np.random.Generator) -> NextPlan:
    """Return what asks a planner in this process, which draws from ``rng``."""
    return lambda vehicle, voxels, visited: ask_for_plan(
        planner, Situation(vehicle, voxels, visited, rng)
    )


def explore(
    render: Callable[[Pose, FloatArray], tuple[ReceivedView, DepthFrame]],
    next_plan: NextPlan,
    start: Pose,
    bounds: Bounds,
    vehicle: Vehicle,
    voxel_size_m: float,
    limits: ExplorationLimits,
    goes_on: Callable[[Exploration], bool],
) -> Exploration:
    """Render from ``start``, then from where a planner says, until it or a limit ends it.

    Args:
        render: Returns the view from a pose at the end of a path of (K, 3) positions; raises
            `RenderError` where the pose is refused, `DeadlineExceededError` where nothing comes.
        next_plan: Asks the planner, after every view.
        start: A pose around which there is room for the vehicle.
        bounds: The box to fly in and to observe.
        vehicle: What flies; its camera's intrinsics and pose are those that come with the views.
        voxel_size_m: Of the observed map.
        limits: When to end.
        goes_on: Called after every view; returns whether to go on.

    Returns:
        What was explored until then, also where it failed: the first pose was refused, a view was
        not received, or the planner raised, took too long, asked for a pose that it cannot reach,
        or for `MAX_REFUSALS` in a row that were refused.
    """
    result, voxels = Exploration(), OccupancyMap(bounds, voxel_size_m)
    voxels.set_free(start.position_m, vehicle.radius_m + 2 * voxel_size_m)
    plan, flown_m, refused = Plan(start, np.array([start.position_m])), 0.0, 0
    result.end(f"{limits.views} views")
    while True:
        try:
            view, frame = render(plan.pose, plan.path_m)
        except (DeadlineExceededError, RenderError) as error:
            refused += 1
            if reason := reason_to_end(error, result, refused):
                result.end(reason, failed=True)
                break
        else:
            refused = 0
            _integrate(voxels, frame, vehicle)
            result.poses.append(plan.pose)
            result.views.append(view)
            result.path_m.append(flown_m)
            if not goes_on(result):
                result.end("coverage")
                break
            if len(result.poses) == limits.views:
                break
        found = _time_plan(next_plan, vehicle, voxels, result)
        if found is None:
            break
        length_m = float(np.linalg.norm(np.diff(found.path_m, axis=0), axis=1).sum())
        if flown_m + length_m > limits.path_m:
            result.end(f"{limits.path_m:g} m of path")
            break
        plan, flown_m = found, flown_m + length_m
    return result


def reason_to_end(error: OaisysError, result: Exploration, refused: int) -> str:
    """Return why a view that did not come ends it all; empty: the planner may ask for another."""
    if isinstance(error, DeadlineExceededError):
        return str(error)
    result.refused += 1
    if not result.poses:
        return f"the first view was refused: {error}"
    if refused == MAX_REFUSALS:
        return f"{refused} poses in a row were refused: {error}"
    return ""


def _time_plan(
    next_plan: NextPlan, vehicle: Vehicle, voxels: OccupancyMap, result: Exploration
) -> Plan | None:
    """Return the next plan; None, once noted in ``result``, where there is none."""
    started_s = time.perf_counter()
    try:
        plan = next_plan(vehicle, voxels, result.poses)
    except PlannerError as error:
        result.end(str(error), failed=True)
        return None
    result.plan_s.append(time.perf_counter() - started_s)
    if plan is None:
        result.end("nothing to gain")
    return plan


def _integrate(voxels: OccupancyMap, frame: DepthFrame, vehicle: Vehicle) -> None:
    depth_m, _ = rectify(frame.depth_m, None, frame.intrinsics)
    camera = rectify_camera(frame.intrinsics)
    voxels.integrate(depth_m, camera, frame.T_map_camera, vehicle.max_range_m)
