"""What independent odometry programs make of a recorded drive; those that are installed."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.drive.outputs import GROUND_TRUTH, ODOMETRY_ESTIMATE, RecordedDrive
from oaisys_core.types import FloatArray, ImuInfo, LidarInfo
from oaisys_mapping.odometry.inertial import preintegrate
from oaisys_mapping.odometry.lidar_odometry import judge, kiss_icp
from oaisys_mapping.odometry.programs import ProgramError
from oaisys_mapping.odometry.trajectories import ape_rmse, read_tum

MAX_RANGE_M = 30.0
"""KISS-ICP ignores farther points, and maps with voxels of a hundredth of it."""

MIN_WAY_M = 1.0
"""On a shorter way, errors are not given as shares of it."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class OdometryCheck:
    """What one program makes of one sensor.

    Attributes:
        sensor: The sensor, or ``odometry``.
        program: Name of the program.
        figures: Figures by name; empty if it could not run.
        problem: Why it could not run.
    """

    sensor: str
    program: str
    figures: dict[str, Any]
    problem: str = ""


def odometry_checks(drive: RecordedDrive, bag: Path | None, say: Say) -> list[OdometryCheck]:
    """Run all programs on the files and the bag of a drive.

    Args:
        drive: The drive.
        bag: Folder of its bag; None if there is none.
        say: Called before each program.
    """
    info = drive.description.info
    if drive.description.length_m < MIN_WAY_M or len(drive.motion.times_s) < 2:
        return []
    checks = [_check("odometry", "evo", say, lambda: _odometry_figures(drive))]
    for lidar in info.lidars:
        checks += _lidar_checks(drive, lidar, bag, say)
    for imu in info.imus:
        checks.append(_check(imu.name, "gtsam", say, partial(_imu_figures, drive, imu)))
    return checks


def _check(
    sensor: str, program: str, say: Say, measure: Callable[[], dict[str, Any]]
) -> OdometryCheck:
    say(f"{program} on {sensor}")
    try:
        return OdometryCheck(sensor, program, measure())
    except ProgramError as error:
        say(f"{program} on {sensor}: {error}")
        return OdometryCheck(sensor, program, {}, str(error))


def _odometry_figures(drive: RecordedDrive) -> dict[str, Any]:
    """Return evo's absolute pose error of what odometry estimates."""
    folder = drive.description.folder
    files = (folder / GROUND_TRUTH, folder / ODOMETRY_ESTIMATE)
    return {
        "poses": len(drive.motion.times_s),
        "ape_rmse_m": ape_rmse(*files),
        "ape_rmse_deg": ape_rmse(*files, "angle_deg"),
    }


def _lidar_checks(
    drive: RecordedDrive, lidar: LidarInfo, bag: Path | None, say: Say
) -> list[OdometryCheck]:
    """Return what KISS-ICP makes of a lidar, with each point's time and without."""
    if bag is None:
        return [OdometryCheck(lidar.name, "kiss-icp", {}, "it reads the bag, and there is none")]
    truth = read_tum(drive.description.folder / GROUND_TRUTH)
    topic = points_topic(lidar, drive.counts["bag"])

    def figures(deskew: bool, scan_s: float) -> dict[str, Any]:
        estimate = kiss_icp(bag, topic, max_range_m=MAX_RANGE_M, deskew=deskew)
        return asdict(judge(estimate, truth, lidar.T_base_lidar, scan_s))

    with_times = _check(
        lidar.name, "kiss-icp", say, lambda: figures(deskew=True, scan_s=lidar.period_s)
    )
    if with_times.problem:
        return [with_times]
    without = _check(
        lidar.name,
        "kiss-icp without the points' times",
        say,
        lambda: figures(deskew=False, scan_s=lidar.period_s / 2),
    )
    return [with_times, without]


def points_topic(lidar: LidarInfo, topics: Collection[str]) -> str:
    """Return the topic of a lidar among those of a bag: ``lidar`` for the only one."""
    own = f"/{lidar.name}/points"
    return own if own in topics else "/lidar/points"


def _imu_figures(drive: RecordedDrive, imu: ImuInfo) -> dict[str, Any]:
    motion = drive.motion
    return asdict(
        preintegrate(
            drive.imus[imu.name],
            read_tum(drive.description.folder / GROUND_TRUTH),
            _twists(motion.velocity_m_s, motion.angular_rate_rad_s),
            imu.T_base_imu,
            drive.description.gravity_m_s2,
        )
    )


def _twists(velocity_m_s: FloatArray, angular_rate_rad_s: FloatArray) -> FloatArray:
    return np.hstack((velocity_m_s, angular_rate_rad_s))
