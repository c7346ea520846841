"""The exploration loop: renders a view, maps its depth, and asks a planner for the next pose."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError, RenderError, quote
from oaisys_core.geometry.poses import check_pose
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import Planner, Situation, Vehicle
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
    """

    poses: list[Pose] = field(default_factory=list)
    path_m: list[float] = field(default_factory=list)
    plan_s: list[float] = field(default_factory=list)
    views: list[ReceivedView] = field(default_factory=list)
    refused: int = 0


def explore(
    render: Callable[[Pose, FloatArray], tuple[ReceivedView, DepthFrame]],
    planner: Planner,
    start: Pose,
    bounds: Bounds,
    vehicle: Vehicle,
    voxel_size_m: float,
    limits: ExplorationLimits,
    rng: np.random.Generator,
    goes_on: Callable[[Exploration], bool],
) -> Exploration:
    """Render from ``start``, then from where ``planner`` says, until it or a limit ends it.

    Args:
        render: Returns the view from a pose at the end of a path of (K, 3) positions; raises
            `RenderError` where the pose is refused.
        planner: Asked after every view.
        start: A pose around which there is room for the vehicle.
        bounds: The box to fly in and to observe.
        vehicle: What flies; its camera's intrinsics and pose are those that come with the views.
        voxel_size_m: Of the observed map.
        limits: When to end.
        rng: The planner's.
        goes_on: Called after every view; returns whether to go on.

    Raises:
        RenderError: The first pose was refused, or `MAX_REFUSALS` in a row.
        OaisysError: The planner failed, or asked for what is no pose, or one that it cannot reach.
    """
    result, voxels = Exploration(), OccupancyMap(bounds, voxel_size_m)
    voxels.set_free(start.position_m, vehicle.radius_m + 2 * voxel_size_m)
    pose, flown_m, refused = start, 0.0, 0
    path_m = np.array([start.position_m])
    while len(result.poses) < limits.views:
        try:
            view, frame = render(pose, path_m)
        except RenderError:
            refused += 1
            result.refused += 1
            if not result.poses or refused == MAX_REFUSALS:
                raise
        else:
            refused = 0
            _integrate(voxels, frame, vehicle)
            result.poses.append(pose)
            result.views.append(view)
            result.path_m.append(flown_m)
            if not goes_on(result):
                break
        situation = Situation(vehicle, voxels, result.poses, rng)
        next_pose = _time_plan(planner, situation, result)
        if next_pose is None:
            break
        path_m = _path_to(situation, next_pose)
        length_m = float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum())
        if flown_m + length_m > limits.path_m:
            break
        pose, flown_m = next_pose, flown_m + length_m
    return result


def _time_plan(planner: Planner, situation: Situation, result: Exploration) -> Pose | None:
    started_s = time.perf_counter()
    pose = _ask(planner, situation)
    result.plan_s.append(time.perf_counter() - started_s)
    return pose


def _ask(planner: Planner, situation: Situation) -> Pose | None:
    """Return the pose that a planner, perhaps of another package, asks for.

    Raises:
        OaisysError: It failed, or what it asks for is no pose; names the planner.
    """
    try:
        pose = planner.next_pose(situation)
    except OaisysError:
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {quote(str(error))}"
        raise OaisysError(f"the planner {planner.name!r} failed: {what}") from error
    if pose is None:
        return None
    if not isinstance(pose, Pose):
        raise InvalidInputError(f"planner {planner.name!r}", pose, "a Pose, or None at the end")
    checked = check_pose(pose.position_m, pose.quat_xyzw, f"planner {planner.name!r}: pose")
    return pose if checked == pose else checked


def _integrate(voxels: OccupancyMap, frame: DepthFrame, vehicle: Vehicle) -> None:
    depth_m, _ = rectify(frame.depth_m, None, frame.intrinsics)
    camera = rectify_camera(frame.intrinsics)
    voxels.integrate(depth_m, camera, frame.T_map_camera, vehicle.max_range_m)


def _path_to(situation: Situation, pose: Pose) -> FloatArray:
    """Return the (K, 3) positions of a path to a pose through space that is known to be free.

    Raises:
        OaisysError: There is none: a planner must not ask for such a pose.
    """
    path_m = situation.path_m(np.asarray(pose.position_m))
    if path_m is None:
        position = np.round(pose.position_m, 2).tolist()
        raise OaisysError(f"the planner asked for {position}, to which no way is known to be free")
    return path_m
