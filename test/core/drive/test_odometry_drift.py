"""Odometry that drifts as configured: closed forms, seeds, and what does not change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config.sections.drive import OdometryDriftConfig
from oaisys_core.drive.odometry_drift import OdometryDrift
from oaisys_core.trajectory import Trajectory
from oaisys_core.types import FloatArray

WAY_M = 25.0
TIMES_S = np.linspace(0.0, 10.0, 501)


@pytest.fixture(scope="module")
def way() -> Trajectory:
    """Return a straight drive of 25 m that turns about x meanwhile."""
    knots_s = np.linspace(0.0, 10.0, 6)
    positions_m = np.outer(knots_s / 10.0, (WAY_M, 0.0, 0.0)) + np.array((3.0, -1.0, 2.0))
    quats = Rotation.from_rotvec(np.outer(knots_s / 20, (1.0, 0.0, 0.0))).as_quat()
    return Trajectory(knots_s, positions_m, quats)


def errors(way: Trajectory, seed: int, **config: float) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3) errors of positions and rotation vectors."""
    drift = OdometryDrift(OdometryDriftConfig(seed=seed, **config), way, TIMES_S, batch_seed=5)
    poses = [each.pose for each in drift.estimates(TIMES_S)]
    turned = Rotation.from_quat([pose.quat_xyzw for pose in poses]) * way.rotation(TIMES_S).inv()
    positions_m = np.array([pose.position_m for pose in poses])
    return positions_m - way.position_m(TIMES_S), turned.as_rotvec()


def test_errors_grow_with_the_root_of_the_way(way: Trajectory) -> None:
    found = [
        errors(way, seed, position_m_per_sqrt_m=0.02, rotation_deg_per_sqrt_m=0.1)
        for seed in range(150)
    ]

    ends_m = np.array([positions[-1] for positions, _ in found])
    ends_rad = np.array([rotations[-1] for _, rotations in found])
    middle_m = np.array([positions[250] for positions, _ in found])
    # 450 draws: their standard deviation is known within 7 % (two sigma).
    assert ends_m.std() == pytest.approx(0.02 * WAY_M**0.5, rel=0.1)
    assert middle_m.std() == pytest.approx(0.02 * (WAY_M / 2) ** 0.5, rel=0.1)
    assert np.degrees(ends_rad.std()) == pytest.approx(0.1 * WAY_M**0.5, rel=0.1)
    assert not np.any([positions[0] for positions, _ in found])


def test_evos_ape_is_that_of_a_random_walk(way: Trajectory) -> None:
    """On three axes, the mean square after s metres is 3 sigma² s; s grows evenly here."""
    evo = pytest.importorskip("evo.core.metrics", exc_type=ModuleNotFoundError)
    trajectory = pytest.importorskip("evo.core.trajectory", exc_type=ModuleNotFoundError)
    true_m = way.position_m(TIMES_S)
    turned_wxyz = np.roll(way.rotation(TIMES_S).as_quat(), 1, axis=1)
    reference = trajectory.PoseTrajectory3D(true_m, turned_wxyz, TIMES_S)

    squares = []
    for seed in range(150):
        error_m, _ = errors(way, seed, position_m_per_sqrt_m=0.02)
        estimate = trajectory.PoseTrajectory3D(true_m + error_m, turned_wxyz, TIMES_S)
        ape = evo.APE(evo.PoseRelation.translation_part)
        ape.process_data((reference, estimate))
        squares.append(ape.get_statistic(evo.StatisticsType.rmse) ** 2)

    assert np.mean(squares) ** 0.5 == pytest.approx(0.02 * (3 * WAY_M / 2) ** 0.5, rel=0.1)


def test_a_wrong_scale_stretches_the_way(way: Trajectory) -> None:
    error_m, _ = errors(way, 1, scale_error=0.02)

    assert error_m == pytest.approx(0.02 * (way.position_m(TIMES_S) - (3, -1, 2)), abs=1e-9)


def test_the_standard_deviation_is_told(way: Trajectory) -> None:
    config = OdometryDriftConfig(position_m_per_sqrt_m=0.02, rotation_deg_per_sqrt_m=0.1)

    last = OdometryDrift(config, way, TIMES_S, batch_seed=5).estimates(TIMES_S)[-1]

    assert last.sigma_m == pytest.approx(0.02 * WAY_M**0.5)
    assert np.degrees(last.sigma_rad) == pytest.approx(0.1 * WAY_M**0.5)


def test_the_same_seed_gives_the_same_errors_at_other_times(way: Trajectory) -> None:
    drift = OdometryDrift(
        OdometryDriftConfig(position_m_per_sqrt_m=0.1), way, TIMES_S, batch_seed=5
    )
    between_s = (TIMES_S[:-1] + TIMES_S[1:]) / 2

    at = np.array([each.pose.position_m for each in drift.estimates(TIMES_S)])
    between = np.array([each.pose.position_m for each in drift.estimates(between_s)])

    assert between == pytest.approx((at[:-1] + at[1:]) / 2, abs=1e-6)
    again = errors(way, 0, position_m_per_sqrt_m=0.1)[0]
    assert (again == at - way.position_m(TIMES_S)).all()
    assert (errors(way, 1, position_m_per_sqrt_m=0.1)[0] != again).any()
