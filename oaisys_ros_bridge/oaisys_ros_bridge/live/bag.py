"""Records what the live page renders into a bag, on the topics of the bridge."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from oaisys_core.drive.outputs import DriveDescription
from oaisys_core.errors import BackendUnavailableError, OaisysError
from oaisys_core.geometry import invert, pose_to_matrix, xyz
from oaisys_core.types import ODOMETRY, DriveInstant, Pose, Sample, SimulatorInfo, Twist

STILL = Twist((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class LiveBag:
    """An open bag; each sample is stamped with the time since it was begun.

    Twists in ``ground_truth/odometry`` are means since the sample before.
    """

    def __init__(self, folder: Path, info: SimulatorInfo) -> None:
        """Begin a bag in a new folder.

        Raises:
            BackendUnavailableError: There is no ROS here.
            OaisysError: It cannot be written.
        """
        try:
            from oaisys_ros_bridge.bags.drive_bag import DriveBag, messages_by_topic
        except ImportError as error:
            raise BackendUnavailableError(f"no bag without ROS: {error}") from error
        self.folder = folder / "bag"
        self._messages_by_topic = messages_by_topic
        self._bag = DriveBag(_description(folder, info))
        self._began_ns = time.monotonic_ns()
        self._last: tuple[int, Pose] | None = None
        self._written: Counter[str] = Counter()

    def write(self, sample: Sample) -> None:
        """Write a sample, with transforms, odometry and clock.

        Raises:
            OaisysError: It cannot be written.
        """
        time_ns = time.monotonic_ns() - self._began_ns
        if self._last is not None:
            time_ns = max(time_ns, self._last[0] + 1)
        twist = STILL if self._last is None else mean_twist(*self._last, time_ns, sample.rig_pose)
        instant = DriveInstant(
            time_ns=time_ns,
            pose=sample.rig_pose,
            velocity_m_s=twist.velocity_m_s,
            angular_rate_rad_s=twist.angular_rate_rad_s,
            has_odometry=True,
            odometry=sample.odometry,
            sensors=tuple(dict.fromkeys(frame.sensor for frame in sample.frames)),
            sample=sample,
        )
        self._bag.write(instant)
        self._last = (time_ns, sample.rig_pose)
        self._written["samples"] += 1
        self._written["images"] += len(sample.frames)

    def finish(self) -> str:
        """Close the bag, read it again, and return in words what it holds.

        Raises:
            OaisysError: It holds fewer images than were written.
        """
        self._bag.close()
        counts: Mapping[str, int] = self._messages_by_topic(self.folder)
        images = sum(count for topic, count in counts.items() if topic.endswith("/image_raw"))
        due = self._written["images"]
        if images != due:
            raise OaisysError(f"{self.folder}: {images} images in the bag, expected {due}")
        return f"{self.folder}: {self._written['samples']} samples, {sum(counts.values())} messages"

    def close(self) -> None:
        """Close the bag; what was written until then can be read."""
        self._bag.close()


def mean_twist(before_ns: int, before: Pose, now_ns: int, now: Pose) -> Twist:
    """Return the mean velocity and rate between two poses, in the axes of the later one.

    The rate is the rotation vector between them over the time.
    """
    from scipy.spatial.transform import Rotation

    seconds = (now_ns - before_ns) * 1e-9
    T_now_before = invert(pose_to_matrix(now)) @ pose_to_matrix(before)
    turn_rad = Rotation.from_matrix(T_now_before[:3, :3].T).as_rotvec()
    shift_m = pose_to_matrix(now)[:3, :3].T @ np.subtract(now.position_m, before.position_m)
    return Twist(xyz(shift_m / seconds), xyz(turn_rad / seconds))


def _description(folder: Path, info: SimulatorInfo) -> DriveDescription:
    """Return the drive as far as it is known before it is driven."""
    return DriveDescription(
        folder=folder,
        info=info,
        due={ODOMETRY: 0},
        rates_hz={},
        instant_count=0,
        start_s=0.0,
        end_s=0.0,
        length_m=0.0,
        gravity_m_s2=0.0,
    )
