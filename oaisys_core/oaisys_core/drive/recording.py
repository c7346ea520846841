"""Writing a timed drive to files.

::

    config.yaml                 the complete configuration and its hash
    trajectory.csv              the planned motion of ``base_link``
    odometry.csv                true pose, and twist in ``base_link``, at ``drive.odometry_rate_hz``
    ground_truth.tum            the same poses as a TUM file
    odometry.tum                the poses that odometry estimates, with `drive.odometry_drift`
    imu/data.csv                measurements of an IMU, with EuRoC's columns
    imu/bias.csv                the true biases in them
    batch_0001/                 images, as `oaisys_core.output.writer` describes
    batch_0001/stamps.csv       simulated time and sensors of each sample
    drive.json                  the way, and for each sensor how many measurements were due and made
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.drive.drive import Drive
from oaisys_core.drive.outputs import (
    GROUND_TRUTH,
    ODOMETRY_ESTIMATE,
    DriveDescription,
    StreamCount,
)
from oaisys_core.output.files import append_text, csv_text, write_text
from oaisys_core.output.records import write_json
from oaisys_core.output.writer import SampleWriter
from oaisys_core.trajectory.files import TRAJECTORY_COLUMNS, write_poses, write_trajectory
from oaisys_core.types import ODOMETRY as ODOMETRY_NAME
from oaisys_core.types import DriveInstant, FloatArray

TRAJECTORY, ODOMETRY = "trajectory.csv", "odometry.csv"
SUMMARY, STAMPS = "drive.json", "stamps.csv"

TWIST_COLUMNS = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
IMU_COLUMNS = (
    "#timestamp [ns]",
    *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
    *(f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"),
)
BIAS_COLUMNS = (
    "#timestamp [ns]",
    *(f"b_w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
    *(f"b_a_RS_S_{axis} [m s^-2]" for axis in "xyz"),
)


class DriveWriter:
    """Writes one drive into a folder; all methods may raise `RenderError`.

    Args:
        drive: The drive, whose motion and IMUs are written at once.
        description: The same drive as plain data.
        config: The configuration.

    Raises:
        InvalidInputError: The folder contains a run already.
    """

    def __init__(
        self, drive: Drive, description: DriveDescription, config: SimulationConfig
    ) -> None:
        self._out = description.folder
        self._config = config
        self._due = description.due
        self._labels = dict(description.info.semantic_labels)
        self._samples = SampleWriter(self._out)
        self._samples.begin(config)
        write_trajectory(self._out / TRAJECTORY, drive.plan.trajectory)
        self._written = dict.fromkeys(self._due, 0)
        self._written[ODOMETRY_NAME] = self._write_odometry(drive)
        for imu in description.info.imus:
            self._written[imu.name] = self._write_imu(imu.name, drive)

    def write(self, instant: DriveInstant) -> None:
        """Write the images and scans of one time."""
        if instant.sample is None:
            return
        self._samples.write(instant.sample, self._labels)
        path = self._samples.batch_folder(instant.sample.batch_id) / STAMPS
        rows: list[Sequence[object]] = [] if path.exists() else [("sample_id", "t_ns", "sensors")]
        row = (instant.sample.sample_id, instant.time_ns, " ".join(instant.sensors))
        append_text(path, csv_text([*rows, row]))
        for name in instant.sensors:
            self._written[name] += 1

    def finish(self) -> Mapping[str, StreamCount]:
        """Return how many measurements of each sensor were due and are written."""
        return {name: StreamCount(due, self._written[name]) for name, due in self._due.items()}

    def close(self) -> None:
        """Do nothing: each file is complete when it is written."""

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Write ``drive.json``, which says that the drive is complete."""
        write_json(self._out / SUMMARY, {"config_sha256": config_sha256(self._config), **summary})

    def _write_imu(self, name: str, drive: Drive) -> int:
        """Write all measurements of an IMU and return their number."""
        measured = drive.imu_measurements(name)
        stamps = drive.schedule.times_ns(name).tolist()
        values = np.hstack((measured.angular_rate_rad_s, measured.specific_force_m_s2))
        biases = np.hstack((measured.gyroscope_bias_rad_s, measured.accelerometer_bias_m_s2))
        for file, columns, table in (
            ("data.csv", IMU_COLUMNS, values),
            ("bias.csv", BIAS_COLUMNS, biases),
        ):
            rows = _stamp(stamps, table)
            write_text(self._out / name / file, csv_text([columns, *rows]))
        return len(stamps)

    def _write_odometry(self, drive: Drive) -> int:
        """Write poses and twists at all times of the odometry, and return their number."""
        odometry, drift = drive.odometry(), drive.odometry_drift()
        poses = np.column_stack((odometry.times_s, odometry.positions_m, odometry.quats_xyzw))
        twists = np.hstack((odometry.velocity_m_s, odometry.angular_rate_rad_s))
        rows = np.hstack((poses, twists)).tolist()
        columns = (*TRAJECTORY_COLUMNS, *TWIST_COLUMNS)
        write_text(self._out / ODOMETRY, csv_text([columns, *rows]))
        write_poses(self._out / GROUND_TRUTH, poses)
        estimated = poses
        if drift is not None:
            found = [each.pose for each in drift.estimates(odometry.times_s)]
            numbers = [(*pose.position_m, *pose.quat_xyzw) for pose in found]
            estimated = np.column_stack((odometry.times_s, np.array(numbers)))
        write_poses(self._out / ODOMETRY_ESTIMATE, estimated)
        return len(poses)


def _stamp(times_ns: Sequence[int], table: FloatArray) -> list[Sequence[object]]:
    return [(t, *row) for t, row in zip(times_ns, table.tolist(), strict=True)]
