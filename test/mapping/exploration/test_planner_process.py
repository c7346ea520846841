"""Planners of other packages run in a process of their own, and end nothing but themselves."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from foreign_planners import HANGING, SENDING, install_planners
from waiting import LOAD_FACTOR

from oaisys_core.geometry import T_LINK_OPTICAL
from oaisys_core.types import PinholeIntrinsics
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose
from oaisys_mapping.exploration.planner_process import PlannerProcess
from oaisys_mapping.exploration.planners import RandomPlanner
from oaisys_mapping.exploration.planning import PlannerError, ask_for_plan

VEHICLE = Vehicle(PinholeIntrinsics(64, 48, 54.0, 54.0, 31.5, 23.5), T_LINK_OPTICAL, 0.6, 12.0)
START_S = 6.0
"""For a planner's process to start and to end."""
HERE = level_pose(np.zeros(3), 0.0)


@pytest.fixture
def voxels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OccupancyMap:
    for name, value in install_planners(tmp_path / "packages").items():
        monkeypatch.setenv(name, value)
    found = OccupancyMap(Bounds(np.full(3, -5.0), np.full(3, 5.0)), 0.5)
    found.set_free((0, 0, 0), 4.0)
    return found


@pytest.mark.usefixtures("no_process_left")
def test_a_planner_that_hangs_is_ended_within_its_time(voxels: OccupancyMap) -> None:
    with PlannerProcess("stuck", 1, timeout_s=1.0) as planner:
        with pytest.raises(PlannerError, match="'stuck' did not choose a pose within 1 s"):
            planner.next_plan(VEHICLE, voxels, [HERE])
        began_s = time.monotonic()
        with pytest.raises(PlannerError, match="'stuck' ended its process"):
            planner.next_plan(VEHICLE, voxels, [HERE])
        assert time.monotonic() - began_s < LOAD_FACTOR * 1.0


@pytest.mark.parametrize("name", [each.name for each in HANGING])
@pytest.mark.usefixtures("no_process_left")
def test_a_planner_that_hangs_is_ended_with_all_that_it_has_started(
    voxels: OccupancyMap, name: str
) -> None:
    """A fork with a session of its own kept the pipe open, and the exploration waited for ever."""
    began_s = time.monotonic()
    with (
        PlannerProcess(name, 1, timeout_s=1.0) as planner,
        pytest.raises(PlannerError, match=f"^the planner '{name}' did not choose a pose within 1"),
    ):
        planner.next_plan(VEHICLE, voxels, [HERE])
    assert time.monotonic() - began_s < LOAD_FACTOR * (1.0 + START_S)


@pytest.mark.parametrize("name", [each.name for each in SENDING])
@pytest.mark.usefixtures("no_process_left")
def test_what_a_planner_sends_that_is_no_answer_is_quoted(voxels: OccupancyMap, name: str) -> None:
    """It was unpickled, and ended the whole command with a traceback."""
    with (
        PlannerProcess(name, 1, timeout_s=60.0) as planner,
        pytest.raises(PlannerError, match=f"'{name}' sent b.*, which is no answer$"),
    ):
        planner.next_plan(VEHICLE, voxels, [HERE])


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("closing", "'closing' closed the connection of its process$"),
        ("daemon_gone", "'daemon_gone' ended its process \\(exit code 3\\)$"),
        ("flooding", "'flooding' sent more than 4000000 bytes, which are no answer$"),
        ("crashing", "'crashing' ended its process \\(SIGSEGV\\)"),
        ("leaving", "'leaving' failed: SystemExit: '0'"),
        ("wordless", "'wordless' failed: Error: 'an error without a text'"),
        ("unmade", "'unmade' failed: RuntimeError: 'weights.pt is missing'"),
    ],
)
@pytest.mark.usefixtures("no_process_left")
def test_a_planner_that_ends_its_process_is_named_with_the_reason(
    voxels: OccupancyMap, name: str, reason: str
) -> None:
    with (
        PlannerProcess(name, 1, timeout_s=60.0) as planner,
        pytest.raises(PlannerError, match=reason),
    ):
        planner.next_plan(VEHICLE, voxels, [HERE])


@pytest.mark.usefixtures("no_process_left")
def test_a_planner_plans_there_what_it_would_plan_here(voxels: OccupancyMap) -> None:
    visited, rng = [HERE], np.random.default_rng(3)
    with PlannerProcess("working", 3, timeout_s=60.0) as planner:
        for _ in range(3):
            expected = ask_for_plan(RandomPlanner(), Situation(VEHICLE, voxels, visited, rng))
            plan = planner.next_plan(VEHICLE, voxels, visited)
            assert plan is not None
            assert expected is not None
            assert plan.pose == expected.pose
            np.testing.assert_array_equal(plan.path_m, expected.path_m)
            visited.append(plan.pose)
            voxels.set_free(plan.pose.position_m, 2.0)


@pytest.mark.parametrize(
    ("arguments", "code"), [(["--help"], 0), ([], 2), (["x", "random", "1"], 2)]
)
def test_as_a_program_it_says_what_it_wants(arguments: list[str], code: int) -> None:
    command = [sys.executable, "-P", "-m", "oaisys_mapping.exploration.planner_process"]
    result = subprocess.run([*command, *arguments], capture_output=True, text=True, check=False)
    assert result.returncode == code
    assert "usage:" in result.stdout + result.stderr
    assert "Traceback" not in result.stderr
