"""An inertial measurement unit: angular rate and specific force along a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core import geometry, randomness
from oaisys_core.config.sections.sensing.imu import ImuConfig
from oaisys_core.trajectory import Trajectory
from oaisys_core.types import FloatArray, ImuInfo, ShortRepr


@dataclass(frozen=True, repr=False)
class ImuMeasurements(ShortRepr):
    """What an IMU measures at N times, in its own frame.

    Attributes:
        times_s: (N,) times of measurement.
        angular_rate_rad_s: (N, 3) angular rate of the IMU.
        specific_force_m_s2: (N, 3) acceleration minus gravity; (0, 0, +9.81) at rest on Earth.
        gyroscope_bias_rad_s: (N, 3) true bias that the angular rate contains.
        accelerometer_bias_m_s2: (N, 3) true bias that the specific force contains.
    """

    times_s: FloatArray
    angular_rate_rad_s: FloatArray
    specific_force_m_s2: FloatArray
    gyroscope_bias_rad_s: FloatArray
    accelerometer_bias_m_s2: FloatArray


def imu_info(imu: ImuConfig) -> ImuInfo:
    """Return an IMU as clients see it."""
    mount = geometry.check_pose(
        imu.mount_position_m, imu.mount_quat_xyzw, f"sensors.imus.{imu.name}.mount"
    )
    root = imu.rate_hz**0.5
    return ImuInfo(
        imu.name,
        geometry.pose_to_matrix(mount),
        imu.rate_hz,
        angular_rate_sigma_rad_s=imu.gyroscope_noise_density * root,
        specific_force_sigma_m_s2=imu.accelerometer_noise_density * root,
    )


def measure(
    config: ImuConfig,
    trajectory: Trajectory,
    times_s: ArrayLike,
    gravity_m_s2: float,
    batch_seed: int = 0,
) -> ImuMeasurements:
    """Return the measurements of an IMU along a trajectory.

    The model is that of Kalibr: true value plus bias plus white noise, where the bias is a random
    walk. Measurements at the first N times do not depend on later times.

    Args:
        config: Mount, noise and seed of the IMU.
        trajectory: Motion of ``base_link``.
        times_s: (N,) times, ``1 / rate_hz`` apart.
        gravity_m_s2: Surface gravity, along ``map``'s -z.
        batch_seed: Seed of the world, so that each world has noise of its own.

    Raises:
        InvalidInputError: A time is outside of the trajectory.
    """
    times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
    rate, force = true_motion(config, trajectory, times, gravity_m_s2)
    rng = randomness.stream(batch_seed, f"imu.{config.name}", config.seed)
    gyroscope, accelerometer = (
        randomness.child(rng, each) for each in ("gyroscope", "accelerometer")
    )
    rate_error, rate_bias = draw_noise(
        len(times),
        config.rate_hz,
        config.gyroscope_noise_density,
        config.gyroscope_random_walk,
        gyroscope,
    )
    force_error, force_bias = draw_noise(
        len(times),
        config.rate_hz,
        config.accelerometer_noise_density,
        config.accelerometer_random_walk,
        accelerometer,
    )
    rate_bias += config.gyroscope_bias_rad_s
    force_bias += config.accelerometer_bias_m_s2
    return ImuMeasurements(
        times,
        rate + rate_bias + rate_error,
        force + force_bias + force_error,
        rate_bias,
        force_bias,
    )


def true_motion(
    config: ImuConfig, trajectory: Trajectory, times_s: FloatArray, gravity_m_s2: float
) -> tuple[FloatArray, FloatArray]:
    """Return the true (N, 3) angular rate and specific force in the IMU's frame.

    The IMU is at a lever arm r from ``base_link`` and feels, in ``base_link``'s axes,
    ``R^T (a - g) + w' x r + w x (w x r)`` with the angular rate w and its derivative w'.
    """
    from scipy.spatial.transform import Rotation

    lever_m = np.array(config.mount_position_m)
    rate = trajectory.angular_rate_rad_s(times_s)
    turning = trajectory.angular_acceleration_rad_s2(times_s)
    upward = trajectory.acceleration_m_s2(times_s) + np.array((0.0, 0.0, gravity_m_s2))
    force = trajectory.rotation(times_s).inv().apply(upward)
    force += np.cross(turning, lever_m) + np.cross(rate, np.cross(rate, lever_m))
    to_imu = Rotation.from_quat(config.mount_quat_xyzw).inv()
    return to_imu.apply(rate), to_imu.apply(force)


def draw_noise(
    count: int, rate_hz: float, density: float, random_walk: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3) white noise and (N, 3) biases, from 0, of an IMU's three axes.

    In discrete time, with the interval dt, white noise has the standard deviation
    ``density / sqrt(dt)``, and each step of the bias ``random_walk * sqrt(dt)``.
    """
    draws = rng.standard_normal((count, 2, 3))
    steps = random_walk * rate_hz**-0.5 * draws[:, 1]
    bias = np.cumsum(steps, axis=0) - steps[:1]
    return density * rate_hz**0.5 * draws[:, 0], bias
