"""What the outputs of a timed drive are given: plain data, for packages that do not know the rest.

`oaisys_core.drive.recording` writes files; other packages add a bag and a report, see
`oaisys_core.extensions`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from oaisys_core.types import (
    DriveInstant,
    FloatArray,
    Frame,
    HeightGrid,
    Odometry,
    Pose,
    ShortRepr,
    SimulatorInfo,
)

GROUND_TRUTH, ODOMETRY_ESTIMATE = "ground_truth.tum", "odometry.tum"
"""Files in a drive's folder: true poses, and those that odometry estimates, at the same times."""


@dataclass(frozen=True)
class StreamCount:
    """How many measurements of a sensor, or messages of a topic, were due and were written."""

    due: int
    written: int


@dataclass(frozen=True)
class DriveDescription:
    """A drive before its first measurement.

    Attributes:
        folder: Where its outputs are written.
        info: The simulator, after the world was made.
        due: The number of measurements of each sensor and of ``odometry``.
        rates_hz: Rates of the same.
        instant_count: Number of different times at which something is due.
        start_s, end_s: Simulated time.
        length_m: Length of the way.
        gravity_m_s2: Gravity that IMUs measure.
        obstacle: What a rover stops in front of, in words; empty for nothing.
    """

    folder: Path
    info: SimulatorInfo
    due: Mapping[str, int]
    rates_hz: Mapping[str, float]
    instant_count: int
    start_s: float
    end_s: float
    length_m: float
    gravity_m_s2: float
    obstacle: str = ""


class DriveRecorder(Protocol):
    """One output of a drive, which is written while it is driven."""

    def write(self, instant: DriveInstant) -> None:
        """Write what is due at one time; called in the order of time."""

    def finish(self) -> Mapping[str, StreamCount]:
        """Complete the output; return what was due and what it contains, by sensor or topic."""

    def close(self) -> None:
        """Close what is open, if the drive failed; after `finish` it does nothing."""


@dataclass(frozen=True, repr=False)
class DriveMotion(ShortRepr):
    """The motion of ``base_link`` at N times at which odometry is due.

    Attributes:
        times_s: (N,) times.
        poses: True poses in ``map``.
        velocity_m_s, angular_rate_rad_s: (N, 3) true twists in ``base_link``.
        estimates: What odometry estimates; empty without drift.
    """

    times_s: FloatArray
    poses: Sequence[Pose]
    velocity_m_s: FloatArray
    angular_rate_rad_s: FloatArray
    estimates: Sequence[Odometry] = ()


@dataclass(frozen=True)
class TimedFrame:
    """A frame and when it was taken, in simulated time."""

    time_ns: int
    frame: Frame


@dataclass(frozen=True, repr=False)
class RecordedDrive(ShortRepr):
    """A drive that is recorded, as reports are given it.

    Attributes:
        description: The drive.
        facts: Facts for the report: seed, versions, seconds.
        counts: What was due and written, by output (``files``, ``bag``) and sensor or topic.
        unavailable: Why an output is missing that can be had, by its name.
        motion: The motion at odometry's times.
        imus: (N, 7) times, angular rates and specific forces, by IMU.
        ground: Heights of the stage.
        pictures: Some frames of the cameras, in the order of time.
        command: Command that repeats the run.
        config_text: The whole configuration.
    """

    description: DriveDescription
    facts: Mapping[str, Any]
    counts: Mapping[str, Mapping[str, StreamCount]]
    unavailable: Mapping[str, str]
    motion: DriveMotion
    imus: Mapping[str, FloatArray]
    ground: HeightGrid
    pictures: Sequence[TimedFrame] = ()
    command: str = ""
    config_text: str = ""

    @property
    def losses(self) -> list[str]:
        """One sentence for each sensor or topic of which not everything due was written."""
        return [
            f"{output}: {count.written} of {count.due} on {name}"
            for output, counts in self.counts.items()
            for name, count in counts.items()
            if count.written != count.due
        ]
