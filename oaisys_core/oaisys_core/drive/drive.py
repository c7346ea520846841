"""A timed drive: every sensor measures at its own rate, in the order of simulated time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

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
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.planning import plan_drive
from oaisys_core.types import FloatArray, ModuleMetadata, Sample, ShortRepr, ignore_progress

ODOMETRY = "odometry"
"""Name under which the schedule counts ground truth and odometry."""


@dataclass(frozen=True)
class TimedSample:
    """The images and scans of all cameras and lidars that are due at one time.

    Attributes:
        time_ns: Simulated time, the stamp of all images and of each scan's beginning.
        sensors: The cameras and lidars.
        sample: What they saw.
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
        rates_hz: Rates of cameras, lidars, IMUs and odometry, by name.
        schedule: When they are due; a lidar's scan must be complete at the end.
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
        sensors = config.sensors
        self._imus = {imu.name: imu for imu in sensors.imus}
        rates = [SensorRate(camera.name, camera.rate_hz) for camera in sensors.all_cameras]
        rates += [
            SensorRate(lidar.name, lidar.rate_hz, duration_s=lidar.period_s)
            for lidar in sensors.lidars
        ]
        self._rendered = frozenset(rate.name for rate in rates)
        rates += [SensorRate(imu.name, imu.rate_hz) for imu in sensors.imus]
        rates.append(SensorRate(ODOMETRY, self._drive.odometry_rate_hz))
        self.rates_hz = {rate.name: rate.rate_hz for rate in rates}
        self.schedule = SensorSchedule(rates, self.plan.trajectory.start_s, self.plan.end_s)

    def sample_count(self) -> int:
        """Return the number of times at which a camera or a lidar is due."""
        times_ns = [self.schedule.times_ns(name) for name in sorted(self._rendered)]
        return len(np.unique(np.concatenate(times_ns)))

    def samples(self, progress: ProgressCallback = ignore_progress) -> Iterator[TimedSample]:
        """Render at each time at which a camera or a lidar is due, and yield what they saw.

        Lidars move along the trajectory during their scans.

        Raises:
            OaisysError: See `Simulation.step_sample`.
        """
        trajectory = self.plan.trajectory
        for due in self.schedule:
            names = tuple(name for name in due.names if name in self._rendered)
            if not names:
                continue
            time_s = due.time_ns / NANOSECONDS
            sample = self._simulation.step_sample(
                ModuleMetadata(sensor={"pose": trajectory.pose(time_s)}),
                sensors=names,
                T_map_base=partial(_pose_after, trajectory, time_s),
                progress=progress,
            )
            yield TimedSample(due.time_ns, names, sample)

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


def _pose_after(trajectory: Trajectory, start_s: float, times_s: FloatArray) -> FloatArray:
    """Return the (N, 4, 4) poses of the rig at times since a sample."""
    return trajectory.T_map_base(start_s + times_s)


def drive_section(config: SimulationConfig) -> DriveConfig:
    """Return the section ``drive`` of a configuration.

    Raises:
        InvalidInputError: It has none.
    """
    if config.drive is None:
        raise InvalidInputError("drive", None, "a section with a vehicle and its waypoints")
    return config.drive
