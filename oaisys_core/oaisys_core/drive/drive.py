"""A timed drive: every sensor measures at its own rate, in the order of simulated time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.backend.base import ProgressCallback
from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.drive import DriveConfig
from oaisys_core.drive.schedule import NANOSECONDS, SensorRate, SensorSchedule
from oaisys_core.errors import InvalidInputError
from oaisys_core.sensing.imu import ImuMeasurements, measure
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory.planning import plan_drive
from oaisys_core.types import FloatArray, ModuleMetadata, Sample, ShortRepr, ignore_progress

ODOMETRY = "odometry"
"""Name under which the schedule counts ground truth and odometry."""


@dataclass(frozen=True)
class CameraSamples:
    """The images of all cameras that are due at one time.

    Attributes:
        time_ns: Simulated time, the stamp of all images.
        sensors: The cameras.
        sample: Their images.
    """

    time_ns: int
    sensors: tuple[str, ...]
    sample: Sample


@dataclass(frozen=True, repr=False)
class OdometrySample(ShortRepr):
    """True poses and twists of ``base_link`` at N times.

    Attributes:
        times_s: (N,) times.
        positions_m, quats_xyzw: (N, 3) and (N, 4) poses in ``map``.
        velocity_m_s, angular_rate_rad_s: (N, 3) twists in ``base_link``, as in
            ``nav_msgs/Odometry``.
    """

    times_s: FloatArray
    positions_m: FloatArray
    quats_xyzw: FloatArray
    velocity_m_s: FloatArray
    angular_rate_rad_s: FloatArray


class Drive:
    """One drive through the current world of a simulation.

    Attributes:
        plan: The motion.
        rates_hz: Rates of cameras, IMUs and odometry, by name.
        schedule: When they are due.
    """

    def __init__(self, simulation: Simulation, config: SimulationConfig) -> None:
        """Plan the drive.

        Args:
            simulation: It must have a world (`Simulation.step_batch`).
            config: Its configuration, with a section ``drive``.

        Raises:
            InvalidInputError: There is no such section, or the vehicle cannot drive this way.
            NotReadyError: There is no world yet.
        """
        self._simulation = simulation
        self._config = config
        self._drive = drive_section(config)
        self.plan = plan_drive(self._drive, simulation.query_height)
        cameras = config.sensors.all_cameras
        self._cameras = frozenset(camera.name for camera in cameras)
        self._imus = {imu.name: imu for imu in config.sensors.imus}
        self.rates_hz = {camera.name: camera.rate_hz for camera in cameras}
        self.rates_hz |= {imu.name: imu.rate_hz for imu in config.sensors.imus}
        self.rates_hz[ODOMETRY] = self._drive.odometry_rate_hz
        rates = [SensorRate(name, rate_hz) for name, rate_hz in self.rates_hz.items()]
        self.schedule = SensorSchedule(rates, self.plan.trajectory.start_s, self.plan.end_s)

    def view_count(self) -> int:
        """Return the number of times at which a camera is due."""
        times_ns = [self.schedule.times_ns(name) for name in sorted(self._cameras)]
        return len(np.unique(np.concatenate(times_ns)))

    def camera_samples(
        self, progress: ProgressCallback = ignore_progress
    ) -> Iterator[CameraSamples]:
        """Render the cameras at each time at which one is due, and yield their images.

        Raises:
            OaisysError: See `Simulation.step_sample`.
        """
        for due in self.schedule:
            cameras = tuple(name for name in due.names if name in self._cameras)
            if cameras:
                pose = self.plan.trajectory.pose(due.time_ns / NANOSECONDS)
                sample = self._simulation.step_sample(
                    ModuleMetadata(sensor={"pose": pose}), sensors=cameras, progress=progress
                )
                yield CameraSamples(due.time_ns, cameras, sample)

    def imu_measurements(self, name: str) -> ImuMeasurements:
        """Return all measurements of an IMU."""
        batch_id = self._simulation.info().batch_id
        return measure(
            self._imus[name],
            self.plan.trajectory,
            self.times_s(name),
            self._drive.gravity_m_s2,
            randomness.batch_seed(self._config.seed, batch_id),
        )

    def odometry(self) -> OdometrySample:
        """Return ground truth and odometry at all times at which they are due."""
        trajectory, times_s = self.plan.trajectory, self.times_s(ODOMETRY)
        rotations = trajectory.rotation(times_s)
        return OdometrySample(
            times_s=times_s,
            positions_m=trajectory.position_m(times_s),
            quats_xyzw=rotations.as_quat(canonical=True),
            velocity_m_s=rotations.inv().apply(trajectory.velocity_m_s(times_s)),
            angular_rate_rad_s=trajectory.angular_rate_rad_s(times_s),
        )

    def times_s(self, name: str) -> FloatArray:
        """Return the (N,) times at which a sensor is due, in seconds."""
        times_ns: NDArray[np.int64] = self.schedule.times_ns(name)
        return np.asarray(times_ns / NANOSECONDS)


def drive_section(config: SimulationConfig) -> DriveConfig:
    """Return the section ``drive`` of a configuration.

    Raises:
        InvalidInputError: It has none.
    """
    if config.drive is None:
        raise InvalidInputError("drive", None, "a section with a vehicle and its waypoints")
    return config.drive
