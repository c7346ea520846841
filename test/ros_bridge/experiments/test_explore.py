"""``oaisys explore`` as a user runs it, and the loop that it runs, without ROS."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from explore_runs import WORLD, run
from std_msgs.msg import Header

from oaisys_core.errors import DeadlineExceededError, InvalidInputError, RenderError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_to_matrix
from oaisys_core.types import PinholeIntrinsics, Pose
from oaisys_mapping.certificate.view_files import read_views
from oaisys_mapping.exploration.flight_box import flight_box
from oaisys_mapping.exploration.occupancy_map import Bounds
from oaisys_mapping.exploration.planner import Planner, Vehicle, level_pose
from oaisys_ros_bridge.bridge.requests import poses_of_trajectory
from oaisys_ros_bridge.conversions import pose_from_msg
from oaisys_ros_bridge.experiments.explore.exploration import (
    MAX_REFUSALS,
    ExplorationLimits,
    explore,
    plans_of,
)
from oaisys_ros_bridge.experiments.explore.plan import planners_of, start_pose
from oaisys_ros_bridge.experiments.explore.trajectory_client import poses_along, trajectory_to_msg
from oaisys_ros_bridge.experiments.options import seeds_of
from oaisys_ros_bridge.experiments.planner_client import ReceivedView
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.publishing.frame_history import FrameHistory

CAMERA = PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5)
VEHICLE = Vehicle(CAMERA, T_LINK_OPTICAL, 0.6, 12.0)
BOUNDS = Bounds(np.array([-10.0, -10, -4]), np.array([10.0, 10, 4]))
START = level_pose(np.array([-8.0, 0, 0]), 0.0)


@pytest.fixture
def world(tmp_path: Path) -> Path:
    path = tmp_path / "world.yaml"
    path.write_text(WORLD, encoding="utf-8")
    return path


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_planners_explore_the_same_worlds_on_a_trajectory_topic(world, tmp_path, ros_domain_id):
    out = tmp_path / "out"
    limits = ("--views", "3", "--baseline-views", "2", "--camera-range", "12")
    options = ("--planner", "all", "--seeds", "4,", "--size", "160x120", *limits)
    result = run(out, world, ros_domain_id, *options, "--via", "trajectory")
    assert result.returncode == 0, result.stderr
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert (figures["closed"], figures["missed"]) == (True, [])
    assert figures["planner"] == "next_best_view"
    assert figures["rmse_m"] < 0.05
    views = read_views(out / "poses.json")
    assert len(figures["coverage"]) == len(views) == figures["views"] == 3
    assert 0 < figures["coverage"][0] < figures["coverage"][-1] < 1
    explorations = figures["explorations"]
    planners = [found["planner"] for found in explorations]
    assert planners == ["next_best_view", "frontier", "grid", "random"]
    assert [len(found["coverage"]) for found in explorations] == [3, 2, 2, 2]
    assert min(found["least_clearance_m"] for found in explorations) > 1.0
    assert {found["seed"] for found in explorations} == {4}
    assert figures["planners"]["random"]["more_than_views"] == 2
    # All of them see the same world from the same first pose.
    assert len({found["coverage"][0] for found in explorations}) == 1
    assert figures["path_length_m"] == explorations[0]["path_m"][-1]
    # What is on the way is not rendered: the way may be longer than straight.
    ends = [view.T_map_camera[:3, 3] for view in views]
    assert explorations[0]["path_m"][1] >= np.linalg.norm(ends[1] - ends[0]) - 1e-6 > 0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "more than 2" in page
    assert (out / "pictures" / "coverage.png").stat().st_size > 10_000
    assert list((out / "bag").glob("*.mcap"))


@pytest.mark.soak
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_views_without_ground_are_told_in_words(world, tmp_path, ros_domain_id):
    options = ("--views", "2", "--size", "64x48", "--no-bag", "--camera-range", "3")
    result = run(tmp_path / "out", world, ros_domain_id, *options, "--start-height", "8")
    assert result.returncode == 1, result.stderr
    assert "sees no ground within 3 m" in result.stdout + result.stderr
    assert "the map is empty: no view" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.long
@pytest.mark.ros
def test_a_planner_that_does_not_exist_is_refused_before_anything_starts(
    world, tmp_path, ros_domain_id
):
    result = run(tmp_path / "out", world, ros_domain_id, "--planner", "oracle")
    assert result.returncode == 2
    assert "oracle" in result.stderr
    assert "next_best_view" in result.stderr
    assert "Traceback" not in result.stderr


class Listed(Planner):
    """Answers with poses of a list."""

    name = "listed"

    def __init__(self, *poses):
        self.poses = list(poses)

    def next_pose(self, _situation):
        return self.poses.pop(0) if self.poses else None


def empty_world(pose, _way_m):
    """Sky all around."""
    depth_m = np.full((48, 64), np.inf, np.float32)
    T_map_camera = pose_to_matrix(pose) @ T_LINK_OPTICAL
    return ReceivedView({}, 0.0, 0.0), DepthFrame(0, depth_m, None, CAMERA, T_map_camera)


def explored(planner, look=empty_world, limits=None):
    limits = limits or ExplorationLimits(views=20)
    rng = np.random.default_rng(0)
    plans = plans_of(planner, rng)
    return explore(look, plans, START, BOUNDS, VEHICLE, 0.5, limits, lambda _: True)


def test_paths_are_as_long_as_what_was_flown():
    there, back = level_pose(np.array([-2.0, 0, 0]), 0.0), level_pose(np.array([-6.0, 0, 0]), 0.0)
    found = explored(Listed(there, back))
    np.testing.assert_allclose(found.path_m, [0, 6, 10])
    assert found.poses == [START, there, back]
    short = explored(Listed(there, back), limits=ExplorationLimits(20, path_m=8.0))
    assert short.poses == [START, there]
    assert (found.ended, short.ended) == ("nothing to gain", "8 m of path")
    assert not found.failed
    few = Listed(there, back)
    assert explored(few, limits=ExplorationLimits(2)).ended == "2 views"
    assert few.poses == [back]


def test_a_pose_that_is_not_known_to_be_free_ends_it():
    behind = level_pose(np.array([-8.0, 9, 0]), 0.0)
    found = explored(Listed(behind))
    assert found.failed
    assert "'listed' asked for [-8.0, 9.0, 0.0], to which no way is known" in found.ended


class Faulty(Planner):
    """Divides by zero."""

    name = "faulty"

    def next_pose(self, situation):
        return situation.vehicle.radius_m / 0


@pytest.mark.parametrize(
    ("planner", "fault"),
    [
        (Faulty(), "the planner 'faulty' failed: ZeroDivisionError"),
        (Listed(Pose((np.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))), "'listed': pose.position"),
        (Listed(Pose((-2.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))), "'listed': pose.orientation"),
        (Listed("home"), "planner 'listed': received 'home', expected a Pose"),
    ],
)
def test_a_planner_that_fails_or_asks_for_no_pose_is_named(planner, fault):
    found = explored(planner)
    assert found.failed
    assert fault in found.ended
    assert found.poses == [START]


def test_refused_poses_are_asked_for_again_elsewhere_but_not_forever():
    steps = [level_pose(np.array([-8.0 + 0.5 * n, 0, 0]), 0.0) for n in range(1, 12)]

    def moody(pose, way_m):
        if pose is steps[0]:
            raise RenderError("no")
        return empty_world(pose, way_m)

    found = explored(Listed(*steps[:2]), moody)
    assert found.poses == [START, steps[1]]
    assert found.refused == 1

    def never(pose, way_m):
        if pose is START:
            return empty_world(pose, way_m)
        raise RenderError("never")

    planner = Listed(*steps)
    found = explored(planner, never)
    assert found.failed
    assert found.ended == f"{MAX_REFUSALS} poses in a row were refused: never"
    assert found.poses == [START]
    assert len(steps) - len(planner.poses) == MAX_REFUSALS


def test_a_first_view_that_is_refused_or_lost_ends_its_exploration_alone():
    """The whole league ended, and the records of all others were lost."""

    def refused(_pose, _way_m):
        raise RenderError("no ground under it")

    def lost(_pose, _way_m):
        raise DeadlineExceededError("no answer within 300 s")

    found = explored(Listed(), refused)
    assert (found.failed, found.refused, found.poses) == (True, 1, [])
    assert found.ended == "the first view was refused: no ground under it"
    found = explored(Listed(), lost)
    assert (found.failed, found.ended) == (True, "no answer within 300 s")


def test_the_way_that_is_flown_ends_at_the_view_and_is_level():
    way_m = np.array([(-8.0, 0, 0), (-4, 2, 1), (-4, 5, 0)])
    last = level_pose(way_m[-1], 2.0)
    poses = poses_along(way_m, last)
    assert poses[-1] is last
    np.testing.assert_allclose([pose.position_m for pose in poses], way_m)
    message = trajectory_to_msg(poses, Header(frame_id="map"))
    frames = FrameHistory("map", "base_link", "odom")
    back = poses_of_trajectory(message, "every", frames)
    np.testing.assert_allclose([pose_from_msg(p.pose).position_m for p in back], way_m)
    for pose, step_m in zip(poses, np.diff(way_m, axis=0), strict=False):
        forward = pose_to_matrix(pose)[:3, 0]
        np.testing.assert_allclose(forward[2], 0, atol=1e-12)
        np.testing.assert_allclose(forward[0] * step_m[1], forward[1] * step_m[0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "first", "seeds"), [("3", 5, (5, 6, 7)), ("4,", 1, (4,)), ("2, 9,2", 1, (2, 9))]
)
def test_worlds_are_counted_or_listed(text, first, seeds):
    assert seeds_of(text, first) == seeds


@pytest.mark.parametrize(
    "text", ["", "0", "-2", "one", ",", "3,-1", "1;2", "9" * 12, "9" * 5000, "1_0"]
)
def test_worlds_that_are_neither_are_refused(text):
    with pytest.raises(InvalidInputError, match="--seeds"):
        seeds_of(text, 1)


def test_planners_are_named_once_each():
    ours = ("next_best_view", "frontier", "grid", "random")
    assert planners_of("all", compare=False) == ours
    assert planners_of("mine", compare=True) == ("mine", *ours)
    assert planners_of("grid, all", compare=False) == ("grid", *ours[:2], ours[3])
    with pytest.raises(InvalidInputError, match="--planner"):
        planners_of(" , ", compare=True)


def test_the_box_holds_the_stage_and_the_start_stands_free_in_it():
    def height_m(xy_m):
        return 0.25 * xy_m[:, 0]

    box = flight_box((-20.0, -10.0, 20.0, 10.0), height_m)
    np.testing.assert_allclose(box.low_m[:2], [-20, -10])
    assert -5.0 <= box.low_m[2] < -4.8
    assert 10.8 < box.high_m[2] < 11.1
    pose = start_pose(box, height_m, 3.0, VEHICLE)
    np.testing.assert_allclose(pose.position_m, [-15, -7.5, -15 * 0.25 + 3])
    forward = pose_to_matrix(pose)[:3, 0]
    np.testing.assert_allclose(forward[:2], np.array([15, 7.5]) / np.hypot(15, 7.5))
    with pytest.raises(InvalidInputError, match="--start-height"):
        start_pose(box, height_m, 0.5, VEHICLE)
