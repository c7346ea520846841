"""Planners that are programs of their own take part in ``oaisys explore``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from explore_runs import COARSE, WORLD, run
from foreign_planners import install_planners
from fragile_stage import FRAGILE_SEEDS, install_fragile_stage

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.certificate.view_files import read_views
from oaisys_ros_bridge.experiments.explore.node_planner import node_planner
from oaisys_ros_bridge.experiments.explore.plan import planners_of

MAV_PLANNER = Path(__file__).parents[1] / "mav_planner.py"
TOPICS = "-r pointcloud:=camera/depth_registered/points -r transform:=camera/transform"
KNOWS = "-p camera_pitch:=0.0 -p ray_length:=12.0 -p robot_radius:=0.5"


@pytest.fixture
def world(tmp_path: Path) -> Path:
    path = tmp_path / "world.yaml"
    path.write_text(WORLD, encoding="utf-8")
    return path


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_a_ros_node_explores_beside_a_built_in_planner(world, tmp_path, ros_domain_id):
    out = tmp_path / "out"
    node = f"mav={sys.executable} {MAV_PLANNER} --ros-args {TOPICS} {KNOWS}"
    limits = ("--views", "7", "--baseline-views", "2", "--camera-range", "12", "--no-bag")
    planners = ("--planner", "mav,random", "--node", node)
    result = run(out, world, ros_domain_id, *planners, *limits, "--size", "64x48")
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))
    # Images so coarse leave much of what they saw out of the map: the job failed.
    assert (result.returncode, figures["closed"]) == (1, False), result.stderr
    assert f"missed: {figures['missed'][0]}" in result.stderr
    mav, drawn = figures["explorations"]
    assert [mav["planner"], drawn["planner"]] == ["mav", "random"]
    assert "mav      0 of 1" in result.stderr + result.stdout
    # It turns once where it starts, as nobody else does, and only then flies.
    assert len(mav["coverage"]) == 7
    assert mav["path_m"][:5] == [0.0] * 5
    assert mav["coverage"][0] == drawn["coverage"][0] < mav["coverage"][4] <= mav["coverage"][6]
    places_m = np.array([view.T_map_camera[:3, 3] for view in read_views(out / "poses.json")])
    steps_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    np.testing.assert_allclose(np.diff(mav["path_m"]), steps_m, atol=1e-6)
    assert mav["least_clearance_m"] > 0.5


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_planners_and_worlds_that_fail_are_marked_and_the_others_go_on(
    world, tmp_path, ros_domain_id
):
    """The first world that cannot be built ended the whole league, and nothing was written."""
    world.write_text(WORLD.replace("mountain_1", "fragile"), encoding="utf-8")
    failing = f"""bad={sys.executable} -c 'raise SystemExit("no map came")'"""
    nodes = ("--node", failing, "--node", "silent=sleep 1000", "--node-silence", "1")
    planners = ("--planner", "bad,stuck,silent,random", "--plan-timeout", "1", *nodes)
    limits = ("--views", "2", "--baseline-views", "2", "--camera-range", "12")
    packages = tmp_path / "packages"
    variables = install_planners(packages) | install_fragile_stage(packages)
    options = (*planners, *limits, *COARSE, "--no-bag", "--size", "64x48")
    seeds = ("--seeds", FRAGILE_SEEDS)
    result = run(tmp_path / "out", world, ros_domain_id, *options, *seeds, variables=variables)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out" / "bag").exists()
    figures = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    explorations, said = figures["explorations"], result.stderr + result.stdout
    unbuilt, built = explorations[:4], explorations[4:]
    names = ["bad", "stuck", "silent", "random"]
    assert [run["planner"] for run in unbuilt] == [run["planner"] for run in built] == names
    assert all(run["failed"] for run in unbuilt)
    assert unbuilt[0]["least_clearance_m"] is None
    assert "the ground has slid away" in figures["failed"][0]
    assert f"random failed in world {FRAGILE_SEEDS[0]} after 0 views" in said
    drawn = figures["planners"]["random"]
    assert (drawn["failed"], drawn["worlds"]) == (1, 2)

    assert [run["failed"] for run in built] == [True, True, True, False]
    reasons = [run["ended"] for run in built]
    assert reasons[0].endswith("bad ended with exit code 1\n  | no map came")
    assert reasons[1] == "the planner 'stuck' did not choose a pose within 1 s"
    assert reasons[2:] == ["silent commanded no view for 1 s", "2 views"]
    # The map is that of the first one that did not fail.
    assert (figures["planner"], figures["views"]) == ("random", 2)
    assert len(figures["failed"]) == 4 + 3
    assert figures["lost"] == []
    assert f"bad failed in world {FRAGILE_SEEDS[-1]} after 1 view: {reasons[0]}" in said
    assert "did not choose a pose within 1 s" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.soak
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_where_all_planners_fail_the_first_one_is_quoted(world, tmp_path, ros_domain_id):
    failing = f"""bad={sys.executable} -c 'raise SystemExit("no map came")'"""
    options = ("--planner", "bad", "--node", failing, "--no-bag", "--size", "64x48")
    result = run(tmp_path / "out", world, ros_domain_id, *options)
    assert result.returncode == 1
    assert "no planner explored a world: bad ended with exit code 1\n  | no map" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mav", "NAME=COMMAND"),
        ("=ls", "NAME=COMMAND"),
        ("mav='ls", "No closing quotation"),
        ("mav=", "NAME=COMMAND"),
        ("random=ls", "no built-in planner"),
        ("a,b=ls", "without comma"),
        ("../../mav=ls", "a name of at most"),
        ("mav=/no/such/program", "a program that can be run"),
    ],
)
def test_what_names_no_program_is_refused(text: str, expected: str) -> None:
    with pytest.raises(InvalidInputError, match=expected) as caught:
        node_planner(text, 60.0)
    assert caught.value.field == "--node"


def test_programs_follow_the_named_planners_once() -> None:
    assert node_planner("mav=ls -l 'a b'", 5.0).command == ("ls", "-l", "a b")
    assert planners_of("random", ["mav"], compare=False) == ("random", "mav")
    assert planners_of("mav,random", ["mav"], compare=False) == ("mav", "random")
