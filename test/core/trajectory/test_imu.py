"""The IMU: what it measures integrates to the trajectory, and its noise has the given densities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oaisys_core.config.sections.drive import DroneConfig
from oaisys_core.config.sections.sensing.imu import ImuConfig
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.imu import ImuMeasurements, draw_noise, measure
from oaisys_core.types import FloatArray

GRAVITY_M_S2 = 3.728
TURNED = Rotation.from_euler("ZYX", (2.1, -0.4, 0.9))
WAYPOINTS_M = np.array(
    [(0, 0, 5), (12, 3, 7), (18, 14, 4), (6, 20, 9), (-5, 12, 6), (-8, 2, 8), (3, -9, 6)], float
)


def flight() -> Trajectory:
    return plan_flight(DroneConfig(kind="drone", speed_m_s=2.5), WAYPOINTS_M, GRAVITY_M_S2)


def mounted(**changes: object) -> ImuConfig:
    x, y, z, w = TURNED.as_quat().tolist()
    return ImuConfig(mount_position_m=(0.4, -0.3, 0.2), mount_quat_xyzw=(x, y, z, w)).model_copy(
        update=changes
    )


def integrated(
    measurements: ImuMeasurements, T_map_imu: FloatArray, velocity_m_s: FloatArray
) -> FloatArray:
    """Return the position after strapdown integration (trapezoidal rule) from a first state."""
    dt = np.diff(measurements.times_s)
    rates = (measurements.angular_rate_rad_s[1:] + measurements.angular_rate_rad_s[:-1]) / 2
    turns = Rotation.from_rotvec(rates * dt[:, None])
    rotation = Rotation.from_matrix(T_map_imu[:3, :3])
    rotations = [rotation]
    for turn in turns:
        rotation = rotation * turn
        rotations.append(rotation)
    up = (0.0, 0.0, GRAVITY_M_S2)
    acceleration = Rotation.concatenate(rotations).apply(measurements.specific_force_m_s2) - up
    gains = (acceleration[1:] + acceleration[:-1]) / 2 * dt[:, None]
    velocities = velocity_m_s + np.vstack((np.zeros(3), np.cumsum(gains, axis=0)))
    ways = (velocities[1:] + velocities[:-1]) / 2 * dt[:, None]
    return np.asarray(T_map_imu[:3, 3] + ways.sum(axis=0))


def final_error(config: ImuConfig, assumed_lever_m: tuple[float, float, float]) -> float:
    """Return the error after 30 s, as a share of the way."""
    trajectory = flight()
    times_s = trajectory.start_s + 1.0 + np.arange(30 * 200) / 200
    assert times_s[-1] < trajectory.end_s
    T_base_imu = np.eye(4)
    T_base_imu[:3, :3], T_base_imu[:3, 3] = TURNED.as_matrix(), assumed_lever_m
    T_map_imu = trajectory.mount(T_base_imu)(times_s)
    swing = np.cross(trajectory.angular_rate_rad_s(times_s[0]), assumed_lever_m)
    velocity = trajectory.velocity_m_s(times_s[0]) + trajectory.rotation(times_s[0]).apply(swing)
    found = measure(config, trajectory, times_s, GRAVITY_M_S2)
    end_m = integrated(found, T_map_imu[0], velocity[0])
    way_m = np.linalg.norm(np.diff(T_map_imu[:, :3, 3], axis=0), axis=1).sum()
    return float(np.linalg.norm(end_m - T_map_imu[-1, :3, 3]) / way_m)


def test_double_integration_returns_the_trajectory() -> None:
    assert final_error(mounted(), (0.4, -0.3, 0.2)) < 1e-4


def test_integration_with_a_wrong_lever_arm_does_not() -> None:
    assert final_error(mounted(), (0.0, 0.0, 0.0)) > 1e-3


def test_at_rest_it_feels_gravity_alone_and_on_a_turntable_the_centripetal_force() -> None:
    times_s = np.linspace(0, 10, 101)
    still = Trajectory(times_s, np.zeros((101, 3)), np.tile((0, 0, 0, 1), (101, 1)))
    found = measure(ImuConfig(), still, times_s, 1.624)
    assert found.specific_force_m_s2 == pytest.approx(np.tile((0, 0, 1.624), (101, 1)))
    assert np.abs(found.angular_rate_rad_s).max() < 1e-12
    turning = Rotation.from_euler("z", 0.8 * times_s[:, None])
    table = Trajectory(times_s, np.zeros((101, 3)), turning.as_quat())
    found = measure(ImuConfig(mount_position_m=(0.5, 0, 0)), table, times_s, 1.624)
    expected = np.tile((-(0.8**2) * 0.5, 0, 1.624), (101, 1))
    assert found.specific_force_m_s2 == pytest.approx(expected, abs=1e-9)
    assert found.angular_rate_rad_s == pytest.approx(np.tile((0, 0, 0.8), (101, 1)), abs=1e-9)


def test_noise_is_drawn_from_seeds_and_adds_to_the_true_motion() -> None:
    trajectory, times_s = flight(), np.arange(400) / 200
    noisy = {
        "gyroscope_noise_density": 1e-3,
        "accelerometer_noise_density": 1e-2,
        "accelerometer_random_walk": 1e-3,
    }
    true = measure(mounted(), trajectory, times_s, GRAVITY_M_S2)
    one = measure(mounted(**noisy), trajectory, times_s, GRAVITY_M_S2, 7)
    same = measure(mounted(**noisy), trajectory, times_s[:100], GRAVITY_M_S2, 7)
    assert (one.angular_rate_rad_s[:100] == same.angular_rate_rad_s).all()
    assert (one.specific_force_m_s2[:100] == same.specific_force_m_s2).all()
    for other in (
        measure(mounted(**noisy), trajectory, times_s, GRAVITY_M_S2, 8),
        measure(mounted(**noisy, seed=1), trajectory, times_s, GRAVITY_M_S2, 7),
        measure(mounted(**noisy, name="imu_2"), trajectory, times_s, GRAVITY_M_S2, 7),
    ):
        assert (one.angular_rate_rad_s != other.angular_rate_rad_s).any()
    assert not one.gyroscope_bias_rad_s.any()
    assert one.accelerometer_bias_m_s2[-1].any()
    error = one.specific_force_m_s2 - true.specific_force_m_s2 - one.accelerometer_bias_m_s2
    assert error.std() == pytest.approx(1e-2 * 200**0.5, rel=0.1)


def allan_variance(values: FloatArray, rate_hz: float, cluster: int) -> float:
    """Return the overlapping Allan variance of (N, 3) values for clusters of samples (IEEE 952)."""
    angle = np.vstack((np.zeros((1, 3)), np.cumsum(values, axis=0))) / rate_hz
    second = angle[2 * cluster :] - 2 * angle[cluster:-cluster] + angle[: -2 * cluster]
    return float((second**2).mean() / (2 * (cluster / rate_hz) ** 2))


def densities(values: FloatArray, rate_hz: float, taus_s: FloatArray) -> FloatArray:
    """Return noise density N and random walk K of the best ``N^2 / tau + K^2 tau / 3``."""
    variances = [allan_variance(values, rate_hz, round(tau * rate_hz)) for tau in taus_s]
    design = np.column_stack((1 / taus_s, taus_s / 3)) / np.array(variances)[:, None]
    return np.sqrt(np.linalg.lstsq(design, np.ones(len(taus_s)), rcond=None)[0])


def test_allan_deviation_returns_the_noise_density_and_the_random_walk() -> None:
    rate_hz, density, walk = 100.0, 2e-3, 4e-4
    taus_s = np.geomspace(0.1, 100.0, 13)
    found = []
    for seed in range(10):
        white, bias = draw_noise(200_000, rate_hz, density, walk, np.random.default_rng(seed))
        found.append(densities(white + bias, rate_hz, taus_s))
    N, K = np.mean(found, axis=0)
    assert pytest.approx(density, rel=0.05) == N
    assert pytest.approx(walk, rel=0.15) == K
