"""Drones: through their waypoints, within their limits, tilted as their acceleration asks."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.config.sections.drive import DroneConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.waypoint_curve import WaypointCurve
from oaisys_core.types import FloatArray

WAYPOINTS_M = np.array([(0, 0, 2), (10, 0, 6), (14, 8, 3), (4, 12, 5), (4, 12, 12)], float)
GRAVITY_M_S2 = 9.80665


def drone(**keys: object) -> DroneConfig:
    return DroneConfig.model_validate({"kind": "drone", **keys})


def flown(**keys: object) -> Trajectory:
    return plan_flight(drone(**keys), WAYPOINTS_M, GRAVITY_M_S2)


def dense_s(trajectory: Trajectory) -> FloatArray:
    return np.linspace(trajectory.start_s, trajectory.end_s, 5001)


@pytest.mark.parametrize("limits", [(2.0, 1.0), (10.0, 1.5), (0.5, 8.0)])
def test_a_drone_flies_through_its_waypoints_within_its_limits(limits: tuple[float, float]) -> None:
    made = flown(speed_m_s=limits[0], acceleration_m_s2=limits[1])
    times_s = dense_s(made)
    positions_m = made.position_m(times_s)
    for waypoint_m in WAYPOINTS_M:
        assert np.linalg.norm(positions_m - waypoint_m, axis=1).min() < 0.03
    speeds = np.linalg.norm(made.velocity_m_s(times_s), axis=1)
    accelerations = np.linalg.norm(made.acceleration_m_s2(times_s), axis=1)
    assert speeds.max() <= limits[0] * (1 + 1e-3)
    assert accelerations.max() <= limits[1] * (1 + 1e-3)
    # It uses one of them, or it would be slower than it must.
    assert speeds.max() > 0.95 * limits[0] or accelerations.max() > 0.9 * limits[1]
    assert speeds[[0, -1]] == pytest.approx(0, abs=1e-3)


def test_a_drone_hovers_at_each_waypoint() -> None:
    through, staying = flown(), flown(hover_s=3.0)
    assert staying.duration_s > through.duration_s + 3.0 * len(WAYPOINTS_M)
    times_s = dense_s(staying)
    positions_m = staying.position_m(times_s)
    for waypoint_m in WAYPOINTS_M:
        is_there = np.linalg.norm(positions_m - waypoint_m, axis=1) < 0.02
        assert np.ptp(times_s[is_there]) == pytest.approx(3.0, abs=0.6)


def test_a_single_waypoint_is_hovered_at() -> None:
    made = plan_flight(drone(hover_s=4.0, heading=90), WAYPOINTS_M[:1], GRAVITY_M_S2)
    assert made.duration_s == 4.0
    pose = made.pose(2.0)
    assert pose.position_m == pytest.approx((0, 0, 2))
    assert pose.quat_xyzw == pytest.approx((0, 0, 0.5**0.5, 0.5**0.5))


def test_a_drone_looks_along_its_way_and_thrusts_along_its_z_axis() -> None:
    made = flown()
    R = made.rotation(made.times_s).as_matrix()
    thrust = made.acceleration_m_s2(made.times_s) + np.array((0, 0, GRAVITY_M_S2))
    thrust /= np.linalg.norm(thrust, axis=1, keepdims=True)
    assert R[..., 2] == pytest.approx(thrust, abs=1e-6)
    velocity = made.velocity_m_s(made.times_s)
    is_level = np.hypot(velocity[:, 0], velocity[:, 1]) > 0.5
    way = np.arctan2(velocity[is_level, 1], velocity[is_level, 0])
    yaw = np.arctan2(R[is_level, 1, 0], R[is_level, 0, 0])
    assert np.abs((yaw - way + np.pi) % (2 * np.pi) - np.pi).max() < 0.05
    level = flown(tilts=False, heading=30).rotation(made.times_s[:9]).as_euler("ZYX", degrees=True)
    assert level == pytest.approx(np.tile((30.0, 0, 0), (9, 1)), abs=1e-6)


def test_equal_successive_waypoints_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"drive\.waypoints_m"):
        plan_flight(drone(), WAYPOINTS_M[[0, 1, 1]], GRAVITY_M_S2)


@pytest.mark.parametrize("gap_m", [0.0, 1e-300, 1e-9, 1e-6, 9e-4])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_waypoints_that_hardly_differ_are_refused_by_their_number(
    gap_m: float, dimensions: int
) -> None:
    """One at 1e-9 m, behind others or alone, asked a rover's plan for more memory than there is."""
    way_m = np.zeros((4, dimensions))
    way_m[:, 0] = 0, 2, 2 + gap_m, 4
    with pytest.raises(InvalidInputError, match=r"waypoints_m\.2: .*at least 0\.001 m apart"):
        WaypointCurve(way_m)
    with pytest.raises(InvalidInputError, match=r"waypoints_m\.1: .*at least 0\.001 m apart"):
        WaypointCurve(way_m[1:3] - way_m[1])


def test_waypoints_a_millimetre_apart_are_a_way() -> None:
    assert WaypointCurve(np.array([[0.0, 0], [1.001e-3, 0]])).length_m == pytest.approx(1.001e-3)
