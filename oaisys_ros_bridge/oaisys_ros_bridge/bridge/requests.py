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
    OaisysError,
    RenderError,
    WorkerLostError,
    one_of,
    one_of_keys,
)
from oaisys_core.files.documents import parse_plain_json
from oaisys_core.geometry import T_LINK_OPTICAL, invert, pose_from_matrix, pose_to_matrix
from oaisys_core.types import ModuleMetadata, Pose, SimulatorInfo, TimedPoses
from oaisys_msgs.action import Drive
from oaisys_ros_bridge.conversions import pose_from_msg, pose_to_stamped_msg
from oaisys_ros_bridge.publishing.frame_history import FrameHistory

MAX_POSES = 100_000
"""Of a sweep or a trajectory: some days of rendering."""

MODULES = ("sensor", "environment", "asset", "render", "custom")
MAX_LOST_WORKERS = 2
"""Workers that may end with a sample of the same metadata before this is dropped: the first may
have been killed by somebody else."""

_VIEW_FIELDS = ("modalities", "sensors")
"""Fields of a request beside its metadata that the simulator may refuse."""


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


def drive_request(goal: Drive.Goal, frames: FrameHistory) -> DriveRequest:
    """Return the drive that a goal asks for.

    Args:
        goal: Of the action ``~/drive``.
        frames: See `rig_pose`.

    Raises:
        InvalidInputError: Wrong frame, a point without a transform, or no JSON object.
    """
    changes = json_object("drive_json", goal.drive_json) if goal.drive_json.strip() else {}
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


def metadata_of_module(module: str, metadata_json: str) -> ModuleMetadata:
    """Return the metadata of one module from a JSON object of its keys.

    Raises:
        InvalidInputError: Unknown module, or no JSON object.
    """
    if module not in MODULES:
        raise InvalidInputError("module", module, one_of(MODULES, module))
    return _metadata({module: json_object("metadata_json", metadata_json)})


def metadata_of_modules(metadata_json: str) -> ModuleMetadata | None:
    """Return metadata from a JSON object by module; None if the text is empty.

    Raises:
        InvalidInputError: No JSON object of JSON objects, or an unknown module.
    """
    if not metadata_json.strip():
        return None
    by_module = json_object("metadata_json", metadata_json)
    for module, part in by_module.items():
        if module not in MODULES:
            raise InvalidInputError(f"metadata_json.{module}", part, one_of_keys(MODULES, module))
        if not isinstance(part, dict):
            raise InvalidInputError(f"metadata_json.{module}", part, "a JSON object")
    return _metadata(by_module)


def json_object(field: str, text: str) -> dict[str, Any]:
    """Return the JSON object in a text of a request.

    Raises:
        InvalidInputError: It is none, or beyond the bounds of `parse_plain_json`.
    """
    try:
        value = parse_plain_json(text)
    except ValueError as error:
        raise InvalidInputError(field, text, f"a JSON object ({error})") from None
    if not isinstance(value, dict):
        raise InvalidInputError(field, text, "a JSON object")
    return value


def _metadata(by_module: dict[str, dict[str, Any]]) -> ModuleMetadata:
    if "pose" in by_module.get("sensor", {}):
        received = by_module["sensor"]["pose"]
        raise InvalidInputError("metadata_json.sensor.pose", received, "poses through set_pose")
    return ModuleMetadata(**by_module)


class PendingMetadata:
    """Metadata for the next sample; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._metadata: ModuleMetadata | None = None
        self._lost_workers = 0

    def add(self, metadata: ModuleMetadata) -> None:
        """Merge metadata into what is pending; newer values win."""
        with self._lock:
            self._metadata = (self._metadata or ModuleMetadata()).with_update(metadata)

    @property
    def asset(self) -> ModuleMetadata | None:
        """The pending metadata of the asset module alone; None: nothing is pending."""
        with self._lock:
            metadata = self._metadata
        if metadata is None or not metadata.asset:
            return None
        return ModuleMetadata(asset=metadata.asset)

    def clear(self) -> None:
        """Drop all pending metadata."""
        with self._lock:
            self._metadata, self._lost_workers = None, 0

    @contextmanager
    def lend(self) -> Iterator[ModuleMetadata | None]:
        """Lend the pending metadata to a sample; it is pending again if the sample fails.

        Metadata that the simulator refuses, or with which it cannot render, is dropped: it would
        make every later sample fail. Of the latter, the error says so.
        """
        with self._lock:
            metadata, self._metadata = self._metadata, None
        try:
            yield metadata
        except OaisysError as error:
            if metadata is None or _is_refusal(error):
                raise
            if isinstance(error, RenderError | WorkerLostError) and self._is_to_blame(error):
                modules = ", ".join(name for name in MODULES if getattr(metadata, name))
                told = f"the metadata of {modules} that waited for this sample was dropped"
                raise type(error)(f"{error}; {told}") from error
            with self._lock:
                self._metadata = metadata.with_update(self._metadata or ModuleMetadata())
            raise
        self._lost_workers = 0

    def _is_to_blame(self, error: RenderError | WorkerLostError) -> bool:
        """Return whether the metadata may be what a sample failed by, and forget its failures."""
        with self._lock:
            self._lost_workers += isinstance(error, WorkerLostError)
            if isinstance(error, WorkerLostError) and self._lost_workers < MAX_LOST_WORKERS:
                return False
            self._lost_workers = 0
        return True


def _is_refusal(error: OaisysError) -> bool:
    """Return whether the simulator has refused the metadata of a sample, not its view."""
    if not isinstance(error, InvalidInputError):
        return False
    return "pose" not in error.field and error.field not in _VIEW_FIELDS
