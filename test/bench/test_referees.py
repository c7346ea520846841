"""The bench's referees: COLMAP, Open3D and OpenCV, which know nothing of us, on rendered pictures.

KISS-ICP, GTSAM and evo are in the tests of drives; `make bench` runs all of them in full.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import skip_without_blender
from scipy.spatial.transform import Rotation

from oaisys_core.types import HeightGrid
from oaisys_mapping.certificate.perturbations import FOCAL_FACTOR
from tools.bench.child import run_job
from tools.bench.referees.drivable_way import ASIDE_M, STEP_M, free_ground, slalom, there_and_back
from tools.bench.referees.structure_from_motion import similarity
from tools.bench.settings import Settings
from tools.bench.topics.referees import SEED, lidar_figures, motion_figures, survey_figures

SMALL_WORLD = {
    "stage": {"resolution_px": 257},
    "materials": {"texture_size_px": 512},
    "assets": {"rocks": [{"kind": "angular", "count": [300, 300], "size_m": [0.15, 1.2]}]},
}


def job(name: str, out: Path, **arguments: Any) -> Any:
    skip_without_blender()
    small = Settings(out=out, width_px=320, height_px=240)
    given = {"quality": "preview", "seed": SEED, "world": SMALL_WORLD, **arguments}
    return run_job(f"referees.pictures.{name}", small, lambda _share, _text: None, **given)


def test_a_similarity_is_found_again() -> None:
    rng = np.random.default_rng(2)
    points_m = rng.normal(0, 5, (8, 3))
    R, t = Rotation.random(random_state=3).as_matrix(), np.array((4.0, -2.0, 9.0))
    scale, R_found, t_found = similarity(points_m, 2.5 * points_m @ R.T + t)
    assert scale == pytest.approx(2.5)
    assert R_found == pytest.approx(R)
    assert t_found == pytest.approx(t)


@pytest.mark.long
@pytest.mark.blender
def test_colmap_finds_poses_and_k_and_notices_a_wrong_one(tmp_path: Path) -> None:
    figures = survey_figures(
        "preview",
        job("survey", tmp_path, rows=3, columns=3, wrong_focal=FOCAL_FACTOR),
        wrong_focal=FOCAL_FACTOR,
    )

    missed = [f"{each.name}: {each.median:g}" for each in figures if each.is_met is False]
    assert not missed
    judged = {each.name.removeprefix("colmap_preview_") for each in figures if each.goal}
    assert judged == {
        "known_missing",
        "known_position",
        "unknown_missing",
        "unknown_position",
        "unknown_focal",
        "unknown_principal",
        "fault_focal",
        "fault_position",
    }


def test_faults_that_are_not_found_miss_their_goals() -> None:
    plain = {"end_error_share": 5e-4, "turned_deg": 0.01, "way_m": 86.0, "seconds": 30.0}
    drift = {"ape_m": 0.21, "expected_m": 0.2}
    scan = {"scans": 9, "way_m": 200.0, "drift_share": 4e-3, "time_offset_s": 1e-3}
    lidar = {
        "yaw_rate_deg_s": 25.0,
        "late_offset_s": 21e-3,
        "own_motion": scan,
        "true_motion": scan,
        "no_times": {**scan, "drift_share": 8e-3},
    }

    def missed(turned_deg: float, late_s: float, no_times: float) -> set[str]:
        imu = {"plain": plain, "turned": {**plain, "turned_deg": turned_deg}}
        ignored = {**scan, "drift_share": no_times}
        figures = motion_figures(imu, drift)
        figures += lidar_figures(
            "x",
            {**lidar, "late_offset_s": late_s, "no_times": ignored},
        )
        return {each.name for each in figures if each.is_met is False}

    assert missed(2.02, 0.021, 8e-3) == set()
    assert missed(0.01, 0.001, 3e-3) == {
        "gtsam_fault_turned",
        "kiss_icp_x_fault_late",
        "kiss_icp_x_drift_no_times",
        "kiss_icp_x_fault_no_times",
    }


@pytest.mark.long
@pytest.mark.blender
def test_rgbd_odometry_finds_the_motion_between_pictures(tmp_path: Path) -> None:
    found = job("flight", tmp_path, pictures=6)
    assert found["found"] == found["pairs"] == 5
    assert found["step_m"] > 0.1
    assert found["error_share"] < 0.05
    assert found["error_deg"] < 0.1


def test_a_way_keeps_clear_of_rocks_and_comes_back() -> None:
    cells, cell_m = 160, 0.25
    ground = np.zeros((cells, cells), np.float32)
    surface = ground.copy()
    surface[: cells * 3 // 4, 78:82] = 1.0  # a wall from the south, to be driven around
    first_m = (0.5 - cells / 2) * cell_m
    found = free_ground(HeightGrid(ground, surface, (first_m, first_m), cell_m))

    way_m = there_and_back(found)

    rows, columns = np.round((way_m[:, ::-1] - first_m) / cell_m).astype(int).T
    assert found.distance_m[rows, columns].min() > 0.5
    assert np.linalg.norm(way_m[0] - way_m[-1]) == pytest.approx(ASIDE_M)
    assert np.linalg.norm(np.diff(way_m, axis=0), axis=1).max() < 1.5 * STEP_M
    # Both sides of the wall are reached.
    assert way_m[:, 0].min() < -10
    assert way_m[:, 0].max() > 10


def test_a_slalom_swings_to_both_sides_of_its_way() -> None:
    straight_m = np.column_stack((np.arange(0.0, 42.0, 2.0), np.zeros(21)))
    x_m, y_m = slalom(straight_m, aside_m=0.8, wave_m=10.0).T
    assert y_m[(x_m > 12) & (x_m < 13)] == pytest.approx(0.8)  # a quarter of the second wave
    assert [y_m.min(), y_m.max()] == pytest.approx([-0.8, 0.8])
    assert np.diff(x_m) == pytest.approx(10 / 12)


def test_a_way_follows_a_canyon_rather_than_the_plain_above_it() -> None:
    cells, cell_m = 240, 0.25
    slope = 2 * cell_m * np.arange(cells, dtype=np.float32)
    ground = np.repeat(slope[:, None], cells, axis=1)
    ground[:, :40] = -20.0  # a floor of 10 m by 60 m
    ground[40:160, 60:180] = 20.0  # a plain of 30 m by 30 m
    first_m = (0.5 - cells / 2) * cell_m
    found = free_ground(HeightGrid(ground, ground, (first_m, first_m), cell_m))
    assert found.free[:, :40].any()
    assert not found.free[:, 40:].any()
