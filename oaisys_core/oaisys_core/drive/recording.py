"""Writing a timed drive to files.

::

    config.yaml                 the complete configuration and its hash
    trajectory.csv              the planned motion of ``base_link``
    odometry.csv                true pose, and twist in ``base_link``, at ``drive.odometry_rate_hz``
    ground_truth.tum            the same poses as a TUM file
    imu/data.csv                measurements of an IMU, with EuRoC's columns
    imu/bias.csv                the true biases in them
    batch_0001/                 images, as `oaisys_core.output.writer` describes
    batch_0001/stamps.csv       simulated time and sensors of each sample
    drive.json                  the way, and for each sensor how many measurements were due and made
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.drive.drive import OdometrySample
from oaisys_core.output.files import append_text, write_text
from oaisys_core.output.records import write_json
from oaisys_core.output.writer import SampleWriter
from oaisys_core.sensing.imu import ImuMeasurements
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.files import TRAJECTORY_COLUMNS, write_poses, write_trajectory
from oaisys_core.types import FloatArray, Sample

TRAJECTORY, ODOMETRY, GROUND_TRUTH = "trajectory.csv", "odometry.csv", "ground_truth.tum"
REPORT, STAMPS = "drive.json", "stamps.csv"

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
    """Writes one drive into a folder; all methods may raise `RenderError`."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._samples = SampleWriter(out)

    def begin(self, config: SimulationConfig, trajectory: Trajectory) -> None:
        """Write the configuration and the planned motion.

        Raises:
            InvalidInputError: The folder contains a run already.
        """
        self._samples.begin(config)
        write_trajectory(self._out / TRAJECTORY, trajectory)

    def write_sample(
        self, time_ns: int, sensors: Sequence[str], sample: Sample, labels: dict[int, str]
    ) -> None:
        """Write the images of one time."""
        self._samples.write(sample, labels)
        path = self._samples.batch_folder(sample.batch_id) / STAMPS
        rows: list[Sequence[object]] = [] if path.exists() else [("sample_id", "t_ns", "sensors")]
        append_text(path, _csv_text([*rows, (sample.sample_id, time_ns, " ".join(sensors))]))

    def write_imu(self, name: str, times_ns: Iterable[int], measured: ImuMeasurements) -> None:
        """Write all measurements of an IMU."""
        stamps = list(times_ns)
        values = np.hstack((measured.angular_rate_rad_s, measured.specific_force_m_s2))
        biases = np.hstack((measured.gyroscope_bias_rad_s, measured.accelerometer_bias_m_s2))
        for file, columns, table in (
            ("data.csv", IMU_COLUMNS, values),
            ("bias.csv", BIAS_COLUMNS, biases),
        ):
            rows = _stamped(stamps, table)
            write_text(self._out / name / file, _csv_text([columns, *rows]))

    def write_odometry(self, odometry: OdometrySample) -> None:
        """Write poses and twists at all times of the odometry."""
        poses = np.column_stack((odometry.times_s, odometry.positions_m, odometry.quats_xyzw))
        twists = np.hstack((odometry.velocity_m_s, odometry.angular_rate_rad_s))
        rows = np.hstack((poses, twists)).tolist()
        columns = (*TRAJECTORY_COLUMNS, *TWIST_COLUMNS)
        write_text(self._out / ODOMETRY, _csv_text([columns, *rows]))
        write_poses(self._out / GROUND_TRUTH, poses)

    def finish(self, config: SimulationConfig, report: dict[str, Any]) -> None:
        """Write the report, which says that the drive is complete."""
        write_json(self._out / REPORT, {"config_sha256": config_sha256(config), **report})


def _stamped(times_ns: Sequence[int], table: FloatArray) -> list[Sequence[object]]:
    return [(t, *row) for t, row in zip(times_ns, table.tolist(), strict=True)]


def _csv_text(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
