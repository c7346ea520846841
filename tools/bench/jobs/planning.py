"""Times of choosing the next view while a hill is explored."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, FloatArray, ModuleMetadata, Pose, merge
from oaisys_mapping.exploration.flight_box import flight_box
from oaisys_mapping.exploration.occupancy_map import OccupancyMap
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose
from oaisys_mapping.exploration.planners import CANDIDATES, NextBestViewPlanner
from oaisys_ros_bridge.experiments.explore.plan import start_pose
from tools.bench.settings import Say, Settings, camera

HILL = Path(__file__).parents[3] / "config" / "explore.yaml"
VIEWS = 12
"""Flown before anything is measured: the map is half known then, and full of frontiers."""

VOXEL_M, START_HEIGHT_M = 0.5, 3.0

Answer = TypeVar("Answer")


def next_view(settings: Settings, say: Say) -> dict[str, list[float]]:
    """Return milliseconds of each view's parts."""
    simulation = _hill(settings)
    sensor = simulation.info().sensors[0]
    vehicle = Vehicle(sensor.intrinsics, sensor.T_base_camera)
    extent_m = simulation.info().stage_extent_m
    if extent_m is None:
        raise RuntimeError("the world has no ground")
    bounds = flight_box(extent_m, lambda xy_m: _height_m(simulation, xy_m))
    pose = start_pose(bounds, lambda xy_m: _height_m(simulation, xy_m), START_HEIGHT_M, vehicle)
    voxels, visited, rng = OccupancyMap(bounds, VOXEL_M), list[Pose](), np.random.default_rng(1)
    voxels.set_free(pose.position_m, vehicle.radius_m + 2 * VOXEL_M)
    planner = NextBestViewPlanner()
    found: dict[str, list[float]] = {"score_200_ms": [], "next_view_ms": [], "take_in_ms": []}
    for view in range(VIEWS + settings.runs):
        say(view / (VIEWS + settings.runs), f"view {view + 1}")
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}), modalities=[DEPTH])
        frame = sample.frames[0]
        seen = (frame.data, frame.intrinsics, frame.T_map_camera, vehicle.max_range_m)
        taken_ms, _ = _time(partial(voxels.integrate, *seen))
        visited.append(pose)
        situation = Situation(vehicle, voxels, visited, rng)
        planned_ms, wanted = _time(partial(planner.next_pose, situation))
        if wanted is None:
            raise RuntimeError(f"the planner gave up after {view + 1} views")
        if view >= VIEWS:
            fresh = Situation(vehicle, voxels, visited, rng)
            places_m = fresh.random_positions(CANDIDATES)
            yaws_rad = rng.uniform(-np.pi, np.pi, len(places_m))
            views = [level_pose(p, float(y)) for p, y in zip(places_m, yaws_rad, strict=True)]
            scored_ms, _ = _time(partial(fresh.gains, views))
            for name, value in zip(found, (scored_ms, planned_ms, taken_ms), strict=True):
                found[name].append(value)
        pose = wanted
    simulation.close()
    return found


def _hill(settings: Settings) -> Simulation:
    world = yaml.safe_load(HILL.read_text(encoding="utf-8"))
    sized = merge(world, camera(settings.width_px, settings.height_px))
    simulation = Simulation(config_from_mapping(merge(sized, {"backend": "analytic"})))
    simulation.step_batch()
    return simulation


def _height_m(simulation: Simulation, xy_m: FloatArray) -> FloatArray:
    points_m = np.column_stack((xy_m, np.zeros(len(xy_m))))
    return simulation.query_height(points_m).surface_height_m


def _time(action: Callable[[], Answer]) -> tuple[float, Answer]:
    started_s = time.perf_counter()
    answer = action()
    return 1e3 * (time.perf_counter() - started_s), answer
