"""The options of an exploration, and the box that it flies in."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Vehicle, level_pose
from oaisys_mapping.exploration.planners import BUILT_IN_PLANNERS
from oaisys_ros_bridge.experiments.configuration import ExperimentOptions
from oaisys_ros_bridge.experiments.explore.node_planner import NodePlanner

PACKAGE = "oaisys_ros_bridge"

ALL_PLANNERS = "all"
"""Stands for all planners of this package."""

FIRST_SEED = 1
"""Seed of the first world, where none is given."""

START_SHARE = 0.75
"""Where an exploration starts: this share of the way from the stage's centre to a corner."""


@dataclass(frozen=True)
class ExploreOptions(ExperimentOptions):
    """Options of an exploration.

    Attributes:
        planners: Names of the planners, each of which explores every world.
        programs: Those of them that are programs of their own.
        plan_timeout_s: How long a planner of another package may take for a pose.
        seeds: One world each.
        via: How views are requested: by ``service`` or by ``trajectory``.
        views: Most views of an exploration.
        baseline_views: Most views of each planner but the first.
        until: Coverage at which it ends; 1: when the planner finds no further pose.
        path_m: Longest path.
        planning_voxel_m: Voxel size of the planner's map.
        vehicle_radius_m: Radius of the ball around the vehicle that must be free.
        camera_range_m: Farthest depth that is used.
        start_height_m: Height of the first view above the ground.
    """

    planners: Sequence[str]
    programs: Sequence[NodePlanner]
    plan_timeout_s: float
    seeds: Sequence[int]
    via: str
    views: int
    baseline_views: int
    until: float
    path_m: float
    planning_voxel_m: float
    vehicle_radius_m: float
    camera_range_m: float
    start_height_m: float


def planners_of(text: str, programs: Sequence[str] = (), *, compare: bool) -> tuple[str, ...]:
    """Return the planners that ``--planner`` names, once each, and then the rest of ``programs``.

    With ``compare`` all own ones follow.

    Raises:
        InvalidInputError: It names none.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InvalidInputError("--planner", text, "names with commas between them")
    ours = tuple(BUILT_IN_PLANNERS)
    named = [each for name in names for each in (ours if name == ALL_PLANNERS else (name,))]
    return tuple(dict.fromkeys((*named, *programs, *(ours if compare else ()))))


def require_start_height(above_m: float, radius_m: float) -> None:
    """Raise `InvalidInputError` where the vehicle would touch the surface at its start."""
    if not above_m > radius_m:
        expected = f"above the vehicle's radius of {radius_m:g} m"
        raise InvalidInputError("--start-height", above_m, expected)


def start_pose(
    bounds: Bounds, height_m: Callable[[FloatArray], FloatArray], above_m: float, vehicle: Vehicle
) -> Pose:
    """Return a pose in a corner of the box, ``above_m`` over the surface, turned to the middle.

    Raises:
        InvalidInputError: The vehicle would touch the surface, or the box ends below it.
    """
    middle_m = (np.asarray(bounds.low_m) + np.asarray(bounds.high_m)) / 2
    corner_m = middle_m + START_SHARE * (np.asarray(bounds.low_m) - middle_m)
    corner_m[2] = height_m(corner_m[None, :2])[0] + above_m
    require_start_height(above_m, vehicle.radius_m)
    if corner_m[2] + vehicle.radius_m > bounds.high_m[2]:
        top_m = bounds.high_m[2] - vehicle.radius_m
        expected = f"a height with which the vehicle is below {top_m:.4g} m, within the box"
        raise InvalidInputError("--start-height", above_m, expected)
    way_m = middle_m - corner_m
    return level_pose(corner_m, float(np.arctan2(way_m[1], way_m[0])))


def default_config() -> Path:
    """Return the configuration of the world to explore where none is given.

    Raises:
        ConfigError: The package was installed without it.
    """
    folders = [Path(__file__).parents[4]]
    with contextlib.suppress(PackageNotFoundError):
        folders.append(Path(get_package_share_directory(PACKAGE)))
    for folder in folders:
        if (path := folder / "config" / "explore.yaml").is_file():
            return path
    raise ConfigError("config/explore.yaml is not installed: give a --config")
