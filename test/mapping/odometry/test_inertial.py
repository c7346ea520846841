"""GTSAM integrates our IMU: it ends where the trajectory ends, and a turned IMU is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config.sections.drive import DroneConfig
from oaisys_core.config.sections.sensing.imu import ImuConfig
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.imu import imu_info, measure
from oaisys_mapping.odometry.inertial import ImuFigures, preintegrate
from oaisys_mapping.odometry.trajectories import TimedTransforms

pytest.importorskip(
    "gtsam",
    exc_type=ModuleNotFoundError,
    reason="has no wheel that fits this Python's other packages",
)

MARS_M_S2 = 3.728
WAYPOINTS_M = np.array(
    [(0, 0, 5), (12, 4, 8), (20, 16, 6), (8, 24, 9), (-6, 14, 7), (-2, 2, 6), (9, -5, 6)], float
)


@pytest.fixture(scope="module")
def flight() -> Trajectory:
    return plan_flight(DroneConfig(kind="drone"), WAYPOINTS_M, MARS_M_S2)


def figures(flight: Trajectory, imu: ImuConfig, seen_as: ImuConfig | None = None) -> ImuFigures:
    """Return GTSAM's figures of an IMU that is mounted as ``imu``, but believed to be another."""
    times_s = np.arange(0.0, flight.end_s, 1 / imu.rate_hz)
    measured = measure(imu, flight, times_s, MARS_M_S2)
    table = np.column_stack((times_s, measured.angular_rate_rad_s, measured.specific_force_m_s2))
    odometry_s = np.arange(0.0, flight.end_s, 0.02)
    rotations = flight.rotation(odometry_s)
    twists = np.hstack(
        (
            rotations.inv().apply(flight.velocity_m_s(odometry_s)),
            flight.angular_rate_rad_s(odometry_s),
        )
    )
    truth = TimedTransforms(odometry_s, flight.T_map_base(odometry_s))
    mount = imu_info(seen_as or imu).T_base_imu
    return preintegrate(table, truth, twists, mount, MARS_M_S2)


def test_the_integrated_imu_ends_where_the_flight_does(flight: Trajectory) -> None:
    found = figures(flight, ImuConfig(mount_position_m=(0.2, -0.1, 0.3)))

    assert found.seconds == pytest.approx(30.0, abs=0.1)
    assert found.way_m > 50
    assert found.end_error_share < 1e-3
    assert found.turned_deg < 0.05


@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_imu_that_is_turned_by_two_degrees_is_found(flight: Trajectory, axis: str) -> None:
    quat = Rotation.from_euler(axis, 2.0, degrees=True).as_quat().tolist()

    found = figures(flight, ImuConfig(mount_quat_xyzw=tuple(quat)), seen_as=ImuConfig())

    assert found.turned_deg == pytest.approx(2.0, abs=0.1)
    assert found.end_error_share > 0.1
