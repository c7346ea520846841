"""The times of a drive, each with the true motion and all that is measured without rendering."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.drive.drive import Drive, odometry_at
from oaisys_core.drive.schedule import NANOSECONDS
from oaisys_core.geometry import xyz
from oaisys_core.trajectory.imu import ImuMeasurements
from oaisys_core.types import (
    ODOMETRY,
    DriveInstant,
    FloatArray,
    ImuReading,
    Pose,
    ProgressCallback,
    ignore_progress,
)

CHUNK = 1024
"""Times whose motion is computed together."""


class DriveTimes:
    """All times at which a sensor of a drive measures, in order."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._times_ns = {name: drive.schedule.times_ns(name) for name in drive.rates_hz}
        every = [np.empty(0, np.int64), *self._times_ns.values()]
        self._all_ns: NDArray[np.int64] = np.unique(np.concatenate(every))
        self._measured: dict[str, ImuMeasurements] = {
            name: drive.imu_measurements(name) for name in self._times_ns if name in drive.imu_names
        }
        self._drift = drive.odometry_drift()
        self._rendered = [n for n in self._times_ns if n not in {*drive.imu_names, ODOMETRY}]

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self._all_ns)

    def instants(self, first: int, count: int) -> list[DriveInstant]:
        """Return what happens at ``count`` times from the one with the index ``first`` on.

        Nothing is rendered; ``sensors`` says what will have to be.
        """
        times_ns = self._all_ns[first : first + count]
        motion = odometry_at(self._drive.plan.trajectory, times_ns / NANOSECONDS)
        estimates = self._drift.estimates(times_ns / NANOSECONDS) if self._drift else None
        rows = {name: _rows(due_ns, times_ns) for name, due_ns in self._times_ns.items()}
        return [
            DriveInstant(
                time_ns=int(time_ns),
                pose=_pose(motion.positions_m[i], motion.quats_xyzw[i]),
                velocity_m_s=xyz(motion.velocity_m_s[i]),
                angular_rate_rad_s=xyz(motion.angular_rate_rad_s[i]),
                has_odometry=ODOMETRY in rows and int(rows[ODOMETRY][i]) >= 0,
                odometry=None if estimates is None else estimates[i],
                imus=self._readings(rows, i),
                sensors=tuple(name for name in self._rendered if rows[name][i] >= 0),
            )
            for i, time_ns in enumerate(times_ns)
        ]

    def render(self, progress: ProgressCallback = ignore_progress) -> Iterator[DriveInstant]:
        """Yield what happens at all times, with what cameras and lidars see.

        Raises:
            OaisysError: See `Simulation.step_sample`.
        """
        for first in range(0, len(self), CHUNK):
            for instant in self.instants(first, CHUNK):
                sample = None
                if instant.sensors:
                    sample = self._drive.sample(instant.time_ns, instant.sensors, progress)
                yield replace(instant, sample=sample)

    def _readings(self, rows: Mapping[str, NDArray[np.int64]], i: int) -> tuple[ImuReading, ...]:
        return tuple(
            ImuReading(
                name,
                xyz(measured.angular_rate_rad_s[rows[name][i]]),
                xyz(measured.specific_force_m_s2[rows[name][i]]),
            )
            for name, measured in self._measured.items()
            if rows[name][i] >= 0
        )


def _rows(due_ns: NDArray[np.int64], times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each time the index of the measurement that is due then; -1 for none."""
    if not len(due_ns):
        return np.full(len(times_ns), -1, np.int64)
    at = np.minimum(np.searchsorted(due_ns, times_ns), len(due_ns) - 1)
    return np.where(due_ns[at] == times_ns, at, -1)


def _pose(position_m: FloatArray, quat_xyzw: FloatArray) -> Pose:
    qx, qy, qz, qw = quat_xyzw.tolist()
    return Pose(xyz(position_m), (qx, qy, qz, qw))
