"""Requests to the bridge: cancelled by a token, converted to what the simulator understands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PoseStamped, Transform
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import Header
from trajectory_msgs.msg import MultiDOFJointTrajectory

from oaisys_core.errors import (
    CancelledError,
    InvalidInputError,
    one_of,
)
from oaisys_core.geometry import T_LINK_OPTICAL, invert, pose_from_matrix, pose_to_matrix
from oaisys_core.types import Pose, SimulatorInfo, TimedPoses
from oaisys_msgs.action import Drive
from oaisys_ros_bridge.bridge.metadata import json_object
from oaisys_ros_bridge.conversions import pose_from_msg, pose_to_stamped_msg
from oaisys_ros_bridge.publishing.frame_history import FrameHistory

MAX_POSES = 100_000
"""Of a sweep or a trajectory: some days of rendering."""


@dataclass(frozen=True)
class ViewRequest:
    """A view to render.

    Attributes:
        pose: Where the rig or the sensor goes; None: it stays.
        sensor: Name of the sensor that renders, and whose pose it is; empty: the rig, all sensors.
        modalities: What to render; none: all.
        is_step: Whether it is a step of a paused simulation, which renders nothing else.
    """

    pose: PoseStamped | None
    sensor: str = ""
    modalities: Sequence[str] = ()
    is_step: bool = False


@dataclass(frozen=True)
class DriveRequest:
    """A drive.

    Attributes:
        poses: The motion itself; None: that of the vehicle in the section ``drive``.
        changes: Keys of that section which replace the configured ones.
        sensors: Names of the sensors that measure; none: all.
    """

    poses: TimedPoses | None
    changes: Mapping[str, Any]
    sensors: Sequence[str] = ()


class Cancellation:
    """Requested by any thread; cancels the call that is under way, and refuses all later ones."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reason = ""
        self._stop: Callable[[], object] | None = None

    @property
    def reason(self) -> str:
        """Why the work is cancelled; empty: it is not."""
        return self._reason

    def request(self, reason: str) -> None:
        """Cancel the work; the first reason stays."""
        with self._lock:
            self._reason = self._reason or reason
            if self._stop is not None:
                self._stop()

    def check(self) -> None:
        """Raise `CancelledError` if the work is cancelled."""
        if self._reason:
            raise CancelledError(self._reason)

    @contextmanager
    def stopping_by(self, stop: Callable[[], object]) -> Iterator[None]:
        """Call ``stop`` if the work is cancelled while the block runs.

        Raises:
            CancelledError: It was cancelled before.
        """
        with self._lock:
            self.check()
            self._stop = stop
        try:
            yield
        finally:
            with self._lock:
                self._stop = None


def rig_pose(stamped: PoseStamped, sensor: str, info: SimulatorInfo, frames: FrameHistory) -> Pose:
    """Return the pose of the rig that a request asks for.

    Args:
        stamped: Pose of the rig's ``base_link`` or, if a sensor is named, of that sensor's link
            (x forward, y left, z up), in any frame that the bridge publishes.
        sensor: Name of the sensor, or empty.
        info: The simulator, which knows where the sensor sits.
        frames: Where these frames are.

    Raises:
        InvalidInputError: Unknown frame or sensor, or numbers that are no pose.
    """
    in_frame = pose_from_msg(stamped.pose, "pose.pose")
    pose = frames.pose_in_map(in_frame, stamped.header, "pose.header")
    if not sensor:
        return pose
    links = {s.name: s.T_base_camera @ invert(T_LINK_OPTICAL) for s in info.sensors}
    links |= {lidar.name: lidar.T_base_lidar for lidar in info.lidars}
    if sensor not in links:
        raise InvalidInputError("sensor", sensor, f"empty or {one_of(links, sensor)}")
    return pose_from_matrix(pose_to_matrix(pose) @ invert(links[sensor]))


def poses_in_map(
    header: Header, frames: FrameHistory, field: str
) -> Callable[[PoseMsg], PoseStamped]:
    """Return what turns the poses of one header into poses in the frame of the world.

    Where the header's frame is, is looked up once: what is done with the first pose may move it.

    Args:
        header: Of all the poses.
        frames: Where its frame is.
        field: The header's name in errors.

    Raises:
        InvalidInputError: The frame is unknown; what is returned raises it for numbers that are
            no pose.
    """
    if frames.is_map(header.frame_id):
        return lambda pose: PoseStamped(header=header, pose=pose)
    T_map_frame = frames.transform_to_map(header, field)

    def place(pose: PoseMsg) -> PoseStamped:
        T_frame_pose = pose_to_matrix(pose_from_msg(pose, "pose.pose"))
        in_map = pose_from_matrix(T_map_frame @ T_frame_pose)
        return pose_to_stamped_msg(in_map, Header(stamp=header.stamp))

    return place


def check_count(field: str, poses: Sequence[Any]) -> None:
    """Raise `InvalidInputError` where a request has more than `MAX_POSES` poses."""
    if len(poses) > MAX_POSES:
        raise InvalidInputError(field, f"{len(poses)} poses", f"at most {MAX_POSES}")


def poses_of_trajectory(
    trajectory: MultiDOFJointTrajectory, points: str, frames: FrameHistory
) -> list[PoseStamped]:
    """Return the rig's poses along a trajectory, in the frame of the world.

    They are the transforms of its first joint.

    Args:
        trajectory: Of ``base_link``; times and velocities do not count.
        points: ``every`` or ``last``: which of its points.
        frames: See `rig_pose`.

    Raises:
        InvalidInputError: Wrong frame, no points, or a point without a transform.
    """
    in_map = poses_in_map(trajectory.header, frames, "trajectory.header")
    check_count("trajectory.points", trajectory.points)
    if not trajectory.points:
        raise InvalidInputError("trajectory.points", [], "at least one point")
    for index, point in enumerate(trajectory.points):
        if not point.transforms:
            field = f"trajectory.points[{index}].transforms"
            raise InvalidInputError(field, [], "one transform per joint, at least one")
    chosen = trajectory.points if points == "every" else trajectory.points[-1:]
    return [in_map(_pose_of(point.transforms[0])) for point in chosen]


def drive_changes(drive_json: str) -> dict[str, Any]:
    """Return the keys of the section ``drive`` that a goal replaces; none if the text is empty.

    Raises:
        InvalidInputError: It is no JSON object.
    """
    return json_object("drive_json", drive_json) if drive_json.strip() else {}


def drive_request(goal: Drive.Goal, frames: FrameHistory) -> DriveRequest:
    """Return the drive that a goal asks for.

    Args:
        goal: Of the action ``~/drive``.
        frames: See `rig_pose`.

    Raises:
        InvalidInputError: Wrong frame, a point without a transform, or no JSON object.
    """
    changes = drive_changes(goal.drive_json)
    trajectory = goal.trajectory
    if not trajectory.points:
        return DriveRequest(None, changes, list(goal.sensors))
    stamped = poses_of_trajectory(trajectory, "every", frames)
    poses = [pose_from_msg(each.pose, f"trajectory.points[{i}]") for i, each in enumerate(stamped)]
    since_start = [point.time_from_start for point in trajectory.points]
    timed = TimedPoses(
        times_s=np.array([each.sec + each.nanosec * 1e-9 for each in since_start]),
        positions_m=np.array([pose.position_m for pose in poses]),
        quats_xyzw=np.array([pose.quat_xyzw for pose in poses]),
    )
    return DriveRequest(timed, changes, list(goal.sensors))


def _pose_of(transform: Transform) -> PoseMsg:
    p = transform.translation
    return PoseMsg(position=Point(x=p.x, y=p.y, z=p.z), orientation=transform.rotation)
