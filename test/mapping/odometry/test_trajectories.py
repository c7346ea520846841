"""evo's figures of made-up trajectories, and offsets in time that are found again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.types import FloatArray
from oaisys_mapping.odometry.programs import ProgramError, run_program
from oaisys_mapping.odometry.trajectories import (
    TimedTransforms,
    ape_rmse,
    drift_share,
    read_tum,
    time_offset_s,
)


def winding(times_s: FloatArray) -> TimedTransforms:
    """Return the motion of a body that drives 1 m/s and turns to and fro."""
    T = np.tile(np.eye(4), (len(times_s), 1, 1))
    turns = Rotation.from_rotvec(np.outer(0.8 * np.sin(0.9 * times_s), (0.0, 0.0, 1.0)))
    T[:, :3, :3] = turns.as_matrix()
    T[:, 0, 3], T[:, 1, 3] = times_s, np.sin(0.5 * times_s)
    return TimedTransforms(times_s, T)


def test_evo_finds_the_error_that_was_made(tmp_path: Path) -> None:
    true = winding(np.arange(0.0, 12.0, 0.1))
    wrong = TimedTransforms(true.times_s, true.T.copy())
    wrong.T[:, :3, 3] *= 1.02
    true.write_tum(tmp_path / "true.tum")
    wrong.write_tum(tmp_path / "wrong.tum")

    files = (tmp_path / "true.tum", tmp_path / "wrong.tum")
    expected_m = 0.02 * np.sqrt(np.mean(np.sum(true.T[:, :3, 3] ** 2, axis=1)))
    assert ape_rmse(*files) == pytest.approx(expected_m, rel=1e-5)
    assert ape_rmse(*files, "angle_deg") == pytest.approx(0.0, abs=1e-5)
    # The share is of the way, which winds: chords are a little shorter.
    assert 0.015 < drift_share(*files, true.way_m()) < 0.0201
    assert pytest.approx(true.T, abs=1e-8) == read_tum(files[0]).T


def test_a_trajectory_that_evo_cannot_read_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "bad.tum").write_text("1 2 3\n")
    winding(np.arange(0.0, 3.0, 0.1)).write_tum(tmp_path / "true.tum")

    with pytest.raises(ProgramError, match="evo_ape ended with exit code"):
        ape_rmse(tmp_path / "true.tum", tmp_path / "bad.tum")


@pytest.mark.parametrize("late_s", [-0.07, 0.0, 0.02])
def test_late_stamps_are_found_from_turns(late_s: float) -> None:
    truth = winding(np.arange(-1.0, 15.0, 0.02))
    times_s = np.arange(0.0, 14.0, 0.1)
    # The estimate is in a frame of its own, and its sensor is mounted askew.
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()
    seen = truth.at(times_s).mount(mount)
    start = np.linalg.inv(seen.T[0])
    estimate = TimedTransforms(times_s + late_s, start @ seen.T)

    assert time_offset_s(estimate, truth) == pytest.approx(late_s, abs=1e-3)


def test_a_program_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match="false ended with exit code 1"):
        run_program(["false"], tmp_path)
