"""Configuration of inertial measurement units."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from oaisys_core.config.section import LEAST_RATE_HZ, Position, Quaternion, Section, Vector3

Density = Annotated[float, Field(ge=0, le=1e6)]


class ImuConfig(Section):
    """An inertial measurement unit: three gyroscopes and three accelerometers, without noise.

    The four noise parameters are those of IEEE 952 for continuous time, with the names and units of
    Kalibr's ``imu.yaml``.

    Attributes:
        name: Name of the sensor, its files and its topics.
        rate_hz: Measurements per second.
        mount_position_m, mount_quat_xyzw: Pose of the IMU's frame in ``base_link``.
        gyroscope_noise_density: White noise of each gyroscope, rad/s/sqrt(Hz); IEEE 952's angle
            random walk N.
        gyroscope_random_walk: Random walk of its bias, rad/s^2/sqrt(Hz); the rate random walk K.
        accelerometer_noise_density: White noise of each accelerometer, m/s^2/sqrt(Hz).
        accelerometer_random_walk: Random walk of its bias, m/s^3/sqrt(Hz).
        gyroscope_bias_rad_s, accelerometer_bias_m_s2: Biases at the first measurement.
        seed: Seed of the noise, used together with that of the world and the sensor's name.
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)] = "imu"
    rate_hz: float = Field(default=200.0, ge=LEAST_RATE_HZ, le=100_000)
    mount_position_m: Position = (0.0, 0.0, 0.0)
    mount_quat_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    gyroscope_noise_density: Density = 0.0
    gyroscope_random_walk: Density = 0.0
    accelerometer_noise_density: Density = 0.0
    accelerometer_random_walk: Density = 0.0
    gyroscope_bias_rad_s: Vector3 = (0.0, 0.0, 0.0)
    accelerometer_bias_m_s2: Vector3 = (0.0, 0.0, 0.0)
    seed: int = Field(default=0, ge=0, lt=2**63)
