"""Runs a planned drive, writes its outputs, and collects what a report shows of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.config import SimulationConfig
from oaisys_core.drive.drive import Drive
from oaisys_core.drive.instants import DriveTimes
from oaisys_core.drive.outputs import (
    DriveDescription,
    DriveMotion,
    DriveRecorder,
    RecordedDrive,
    StreamCount,
    TimedFrame,
)
from oaisys_core.output.writer import config_text
from oaisys_core.simulation import Simulation
from oaisys_core.types import (
    DriveInstant,
    FloatArray,
    HeightGrid,
    Pose,
    ProgressCallback,
    ignore_progress,
)

PICTURES = 6
"""Times at which the report shows what a camera saw."""

GROUND_CELLS = 240
"""Cells along the longer edge of the report's map."""

MAP_MARGIN_M = 8.0
"""Least distance from the way to the map's edge."""


def description_of(drive: Drive, simulation: Simulation, folder: Path) -> DriveDescription:
    """Return a planned drive as plain data."""
    plan = drive.plan
    return DriveDescription(
        folder=folder,
        info=simulation.info(),
        due=drive.schedule.counts,
        rates_hz=drive.rates_hz,
        instant_count=len(DriveTimes(drive)),
        start_s=plan.trajectory.start_s,
        end_s=plan.end_s,
        length_m=plan.length_m(),
        gravity_m_s2=plan.gravity_m_s2,
        obstacle="" if plan.obstacle is None else str(plan.obstacle),
    )


def drive_through(
    drive: Drive,
    outputs: Mapping[str, DriveRecorder],
    watchers: Sequence[Callable[[DriveInstant], None]] = (),
    progress: ProgressCallback = ignore_progress,
) -> dict[str, Mapping[str, StreamCount]]:
    """Drive, write everything that is due to all outputs, and return their counts.

    Args:
        drive: The drive.
        outputs: By name; closed at the end.
        watchers: Called with each time after it was written.
        progress: Called with the progress of each sample.

    Raises:
        OaisysError: Rendering or writing failed; the outputs are closed.
    """
    try:
        for instant in DriveTimes(drive).render(progress):
            for output in outputs.values():
                output.write(instant)
            for watch in watchers:
                watch(instant)
        return {name: output.finish() for name, output in outputs.items()}
    finally:
        for output in outputs.values():
            output.close()


class PictureCollector:
    """Keeps some frames of each camera, evenly distributed over the drive."""

    def __init__(self, description: DriveDescription) -> None:
        self._wanted = {
            sensor.name: set(
                np.linspace(0, description.due[sensor.name] - 1, PICTURES).round().astype(int)
            )
            for sensor in description.info.sensors
            if description.due.get(sensor.name)
        }
        self._seen = dict.fromkeys(self._wanted, 0)
        self.pictures: list[TimedFrame] = []

    def take(self, instant: DriveInstant) -> None:
        """Keep the frames of one time, if they are wanted."""
        for name in instant.sensors:
            if name not in self._wanted:
                continue
            number, self._seen[name] = self._seen[name], self._seen[name] + 1
            if number in self._wanted[name] and instant.sample is not None:
                frames = [frame for frame in instant.sample.frames if frame.sensor == name]
                self.pictures += [TimedFrame(instant.time_ns, frame) for frame in frames]


def drive_record(
    drive: Drive,
    simulation: Simulation,
    description: DriveDescription,
    config: SimulationConfig,
    *,
    pictures: Sequence[TimedFrame],
    counts: Mapping[str, Mapping[str, StreamCount]],
    unavailable: Mapping[str, str],
    facts: Mapping[str, Any],
    command: str,
) -> RecordedDrive:
    """Return what a report is given of a drive that is recorded."""
    motion = _motion(drive)
    return RecordedDrive(
        description=description,
        facts=facts,
        counts=counts,
        unavailable=unavailable,
        motion=motion,
        imus={imu.name: _imu_table(drive, imu.name) for imu in description.info.imus},
        ground=_ground(simulation, motion),
        pictures=pictures,
        command=command,
        config_text=config_text(config),
    )


def _motion(drive: Drive) -> DriveMotion:
    truth, drift = drive.odometry(), drive.odometry_drift()
    return DriveMotion(
        times_s=truth.times_s,
        poses=list(_poses(truth.positions_m, truth.quats_xyzw)),
        velocity_m_s=truth.velocity_m_s,
        angular_rate_rad_s=truth.angular_rate_rad_s,
        estimates=() if drift is None else drift.estimates(truth.times_s),
    )


def _poses(positions_m: FloatArray, quats_xyzw: FloatArray) -> Iterable[Pose]:
    for (x, y, z), (qx, qy, qz, qw) in zip(positions_m.tolist(), quats_xyzw.tolist(), strict=True):
        yield Pose((x, y, z), (qx, qy, qz, qw))


def _imu_table(drive: Drive, name: str) -> FloatArray:
    measured = drive.imu_measurements(name)
    return np.column_stack(
        (measured.times_s, measured.angular_rate_rad_s, measured.specific_force_m_s2)
    )


def _ground(simulation: Simulation, motion: DriveMotion) -> HeightGrid:
    """Return the heights around the way, or of the whole stage if that is smaller."""
    places_m = np.array([pose.position_m[:2] for pose in motion.poses])
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    margin_m = max(MAP_MARGIN_M, float((high - low).max()) / 2)
    x0, y0, x1, y1 = simulation.info().stage_extent_m or (-np.inf, -np.inf, np.inf, np.inf)
    west, south = np.maximum(low - margin_m, (x0, y0)).tolist()
    east, north = np.minimum(high + margin_m, (x1, y1)).tolist()
    cell_m = max(east - west, north - south) / GROUND_CELLS
    return simulation.height_grid(cell_m, (west, south, east, north))
