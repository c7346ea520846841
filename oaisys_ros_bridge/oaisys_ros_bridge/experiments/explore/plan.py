"""What an exploration is asked to do, and the box that it flies in."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.certificate.signature import PrivateKey
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Vehicle, level_pose
from oaisys_mapping.exploration.planners import BUILT_IN_PLANNERS
from oaisys_ros_bridge.experiments.system import SystemOptions

PACKAGE = "oaisys_ros_bridge"

ALL_PLANNERS = "all"
"""Stands for all of ours."""

FIRST_SEED = 1
"""Of the first world, where none is given."""

HEADROOM_M = 6.0
"""The box reaches so far above the highest ground."""

START_SHARE = 0.75
"""An exploration starts in a corner, so far out from the middle of the stage."""

PROBES = 64
"""Heights are asked for at so many places along an edge of the stage."""


@dataclass(frozen=True)
class ExploreOptions(SystemOptions):
    """What an exploration is asked to do.

    Attributes:
        planners: Names, each of which explores every world.
        seeds: One world each.
        via: How poses are asked for: ``service`` or ``trajectory``.
        views: Most views of an exploration.
        baseline_views: Most views of all planners but the first.
        until: Coverage at which it ends; 1: only when the planner finds nothing more.
        path_m: Longest path.
        planning_voxel_m: Of the map that plans are made on.
        vehicle_radius_m: The ball around the vehicle that must be free.
        camera_range_m: How far depth is used.
        start_height_m: Above the ground, of the first view.
        key: Signs the certificate; None: nobody does.
    """

    planners: Sequence[str]
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
    key: PrivateKey | None = None


def planners_of(text: str, *, compare: bool) -> tuple[str, ...]:
    """Return the planners that ``--planner`` names, once each; with ``compare`` all of ours, too.

    Raises:
        InvalidInputError: It names none.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InvalidInputError("--planner", text, "names with commas between them")
    ours = tuple(BUILT_IN_PLANNERS)
    named = [each for name in names for each in (ours if name == ALL_PLANNERS else (name,))]
    return tuple(dict.fromkeys((*named, *(ours if compare else ()))))


def worlds_of(text: str, first: int) -> tuple[int, ...]:
    """Return the seeds that ``--seeds`` means: ``3`` is so many from the first on, ``4,7`` those.

    Raises:
        InvalidInputError: It is neither.
    """
    expected = "how many worlds, or their seeds with commas between them"
    try:
        numbers = [int(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InvalidInputError("--seeds", text, expected) from None
    if "," in text:
        if not numbers or min(numbers) < 0:
            raise InvalidInputError("--seeds", text, expected)
        return tuple(dict.fromkeys(numbers))
    if not numbers or numbers[0] < 1:
        raise InvalidInputError("--seeds", text, expected)
    return tuple(range(first, first + numbers[0]))


def flight_box(extent_m: Sequence[float], height_m: Callable[[FloatArray], FloatArray]) -> Bounds:
    """Return the box over a stage, from its lowest ground to well above its highest.

    Args:
        extent_m: (min_x, min_y, max_x, max_y) of the stage.
        height_m: Gives the (N,) heights of the surface at (N, 2) points.
    """
    low_m, high_m = np.array(extent_m[:2]), np.array(extent_m[2:])
    shares = (np.arange(PROBES) + 0.5) / PROBES
    x_m, y_m = np.meshgrid(
        *(low + shares * (high - low) for low, high in zip(low_m, high_m, strict=True))
    )
    heights_m = height_m(np.column_stack((x_m.ravel(), y_m.ravel())))
    lowest_m, highest_m = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
    return Bounds(np.append(low_m, lowest_m), np.append(high_m, highest_m + HEADROOM_M))


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
    if above_m <= vehicle.radius_m or corner_m[2] + vehicle.radius_m > bounds.high_m[2]:
        expected = f"above the vehicle's radius of {vehicle.radius_m:g} m, and within the box"
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
