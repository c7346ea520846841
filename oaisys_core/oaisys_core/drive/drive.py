"""A timed drive: every sensor measures at its own rate, in the order of simulated time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.drive import DriveConfig
from oaisys_core.drive.odometry_drift import OdometryDrift
from oaisys_core.drive.schedule import NANOSECONDS, SensorRate, SensorSchedule
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory import RigMotion, Trajectory
from oaisys_core.trajectory.imu import ImuMeasurements, measure
from oaisys_core.trajectory.planning import DrivePlan, plan_drive
from oaisys_core.types import (
    ODOMETRY,
    FloatArray,
    ModuleMetadata,
    ProgressCallback,
    Sample,
    ShortRepr,
    ignore_progress,
)

MAX_MEASUREMENTS = 5_000_000
"""Measurements of all sensors in one drive: four hours with 340 in a second."""


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
        imu_names: The IMUs among them.
        schedule: When they are due; a lidar's scan must be complete at the end.
    """

    def __init__(
        self,
        simulation: Simulation,
        config: SimulationConfig,
        plan: DrivePlan | None = None,
        sensors: Sequence[str] = (),
    ) -> None:
        """Plan the drive.

        Args:
            simulation: It must have a world (`Simulation.step_batch`).
            config: Its configuration.
            plan: The motion; None for that of the configuration's section ``drive``.
            sensors: Which cameras, lidars and IMUs measure, and whether `ODOMETRY` does; none
                named: all.

        Raises:
            InvalidInputError: There is no such section or sensor, the vehicle cannot drive this
                way, or there would be more than `MAX_MEASUREMENTS`.
            NotReadyError: There is no world yet.
        """
        self._simulation = simulation
        self._config = config
        heights = partial(simulation.query_height, on_stage=True)
        info = simulation.info()
        self.plan = plan or plan_drive(
            drive_section(config), heights, info.sensors, info.georeference
        )
        self._imus = {imu.name: imu for imu in config.sensors.imus}
        self._spans_s = _spans_s(config)
        rates = _choose(_sensor_rates(config, self.plan), sensors)
        self.rates_hz = {rate.name: rate.rate_hz for rate in rates}
        self.imu_names = frozenset(self._imus).intersection(self.rates_hz)
        self._rendered = frozenset(self.rates_hz) - {*self._imus, ODOMETRY}
        count = self.duration_s * sum(self.rates_hz.values())
        if count > MAX_MEASUREMENTS:
            expected = f"a drive with at most {MAX_MEASUREMENTS} measurements"
            raise InvalidInputError("drive.duration_s", self.duration_s, expected)
        self.schedule = SensorSchedule(rates, self.plan.trajectory.start_s, self.plan.end_s)

    @property
    def duration_s(self) -> float:
        """Simulated time from the beginning to the end."""
        return self.plan.end_s - self.plan.trajectory.start_s

    def sample_count(self) -> int:
        """Return the number of times at which a camera or a lidar is due."""
        times_ns = [self.schedule.times_ns(name) for name in sorted(self._rendered)]
        return len(np.unique(np.concatenate(times_ns)))

    def samples(self, progress: ProgressCallback = ignore_progress) -> Iterator[TimedSample]:
        """Render at each time at which a camera or a lidar is due, and yield what they saw.

        Lidars move along the trajectory during their scans, cameras during readout and exposure.

        Raises:
            OaisysError: See `Simulation.step_sample`.
        """
        for due in self.schedule:
            names = tuple(name for name in due.names if name in self._rendered)
            if not names:
                continue
            yield TimedSample(due.time_ns, names, self.sample(due.time_ns, names, progress))

    def sample(
        self, time_ns: int, sensors: Sequence[str], progress: ProgressCallback = ignore_progress
    ) -> Sample:
        """Render what cameras and lidars see at one time of the drive; see `samples`."""
        return self._simulation.step_sample(
            self.metadata_at(time_ns),
            sensors=sensors,
            motion=self.motion_about(time_ns, sensors),
            progress=progress,
        )

    def motion_about(self, time_ns: int, sensors: Sequence[str]) -> RigMotion | None:
        """Return the motion while sensors measure; None if all of them do so in an instant."""
        spans_s = [self._spans_s[name] for name in sensors if name in self._spans_s]
        if not spans_s:
            return None
        first_s, last_s = np.array(spans_s).T
        return self.plan.trajectory.motion_about(
            time_ns / NANOSECONDS, float(first_s.min()), float(last_s.max())
        )

    def metadata_at(self, time_ns: int) -> ModuleMetadata:
        """Return what moves rig and movers to where they are at a time of the drive."""
        time_s, trajectory = time_ns / NANOSECONDS, self.plan.trajectory
        movers = [mover.trajectory for mover in self._simulation.world_config.assets.movers]
        moves = any(mover.speed_m_s is not None for mover in movers)
        return ModuleMetadata(
            sensor={"pose": trajectory.pose(time_s)},
            asset={"time_s": time_s - trajectory.start_s} if moves else None,
        )

    def imu_measurements(self, name: str) -> ImuMeasurements:
        """Return all measurements of an IMU."""
        return measure(
            self._imus[name],
            self.plan.trajectory,
            self.times_s(name),
            self.plan.gravity_m_s2,
            self._simulation.batch_seed,
        )

    def odometry(self) -> OdometrySample:
        """Return ground truth and odometry at all times at which they are due."""
        return odometry_at(self.plan.trajectory, self.times_s(ODOMETRY))

    def odometry_drift(self) -> OdometryDrift | None:
        """Return what odometry estimates; None if it does not drift."""
        drift = self.plan.odometry_drift
        if not drift.active or ODOMETRY not in self.rates_hz:
            return None
        times_s = self.times_s(ODOMETRY)
        return OdometryDrift(drift, self.plan.trajectory, times_s, self._simulation.batch_seed)

    def times_s(self, name: str) -> FloatArray:
        """Return the (N,) times at which a sensor is due, in seconds."""
        times_ns: NDArray[np.int64] = self.schedule.times_ns(name)
        return np.asarray(times_ns / NANOSECONDS)


def odometry_at(trajectory: Trajectory, times_s: FloatArray) -> OdometrySample:
    """Return true poses and twists of ``base_link`` at (N,) times."""
    rotations = trajectory.rotation(times_s)
    return OdometrySample(
        times_s=times_s,
        positions_m=trajectory.position_m(times_s),
        quats_xyzw=rotations.as_quat(canonical=True),
        velocity_m_s=rotations.inv().apply(trajectory.velocity_m_s(times_s)),
        angular_rate_rad_s=trajectory.angular_rate_rad_s(times_s),
    )


def _sensor_rates(config: SimulationConfig, plan: DrivePlan) -> list[SensorRate]:
    """Return the rates of cameras, lidars, IMUs and odometry."""
    sensors = config.sensors
    rates = [
        SensorRate(camera.name, camera.rate_hz, duration_s=camera.readout_s + camera.exposure_s / 2)
        for camera in sensors.all_cameras
    ]
    rates += [
        SensorRate(lidar.name, lidar.rate_hz, duration_s=lidar.period_s) for lidar in sensors.lidars
    ]
    rates += [SensorRate(imu.name, imu.rate_hz) for imu in sensors.imus]
    return [*rates, SensorRate(ODOMETRY, plan.odometry_rate_hz)]


def _choose(rates: Sequence[SensorRate], names: Sequence[str]) -> Sequence[SensorRate]:
    """Return the rates of the named sensors; of all if none is named.

    Raises:
        InvalidInputError: There is no such sensor.
    """
    known = [rate.name for rate in rates]
    for name in names:
        if name not in known:
            raise InvalidInputError("sensors", name, one_of(known, name))
    return [rate for rate in rates if rate.name in names] if names else rates


def _spans_s(config: SimulationConfig) -> dict[str, tuple[float, float]]:
    """Return when each sensor that moves while it measures begins and ends, since its stamp."""
    spans = {lidar.name: (0.0, lidar.period_s) for lidar in config.sensors.lidars}
    for camera in config.sensors.all_cameras:
        if camera.readout_s or camera.exposure_s:
            half_s = camera.exposure_s / 2
            spans[camera.name] = (-half_s, camera.readout_s + half_s)
    return spans


def drive_section(config: SimulationConfig) -> DriveConfig:
    """Return the section ``drive`` of a configuration.

    Raises:
        InvalidInputError: It has none.
    """
    if config.drive is None:
        raise InvalidInputError("drive", None, "a section with a vehicle and its waypoints")
    return config.drive
