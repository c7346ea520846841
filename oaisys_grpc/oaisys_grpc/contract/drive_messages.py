"""Trajectories and timed drives as the contract's messages, and back; in pairs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import (
    DriveInstant,
    DriveOutline,
    ImuReading,
    PlannedTrajectory,
    TimedPoses,
)
from oaisys_grpc.contract.conversion import Conversion, RecordConversion, each
from oaisys_grpc.contract.metadata import POSE, VECTOR
from oaisys_grpc.contract.sample_messages import ODOMETRY
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

MAX_POSES = 50_000
"""Poses of one trajectory: 41 minutes of a planned one, and 3.2 MB."""


def poses_to_proto(poses: TimedPoses) -> pb.TimedPoses:
    """Return the message of timed poses; inverse: `poses_from_proto`."""
    return pb.TimedPoses(
        times_s=np.asarray(poses.times_s, np.float64).ravel().tolist(),
        positions_m=np.asarray(poses.positions_m, np.float64).ravel().tolist(),
        quats_xyzw=np.asarray(poses.quats_xyzw, np.float64).ravel().tolist(),
    )


def poses_from_proto(message: pb.TimedPoses) -> TimedPoses:
    """Return timed poses.

    Raises:
        InvalidInputError: There are not as many positions and orientations as times, or too many.
    """
    count = len(message.times_s)
    received = (count, len(message.positions_m), len(message.quats_xyzw))
    if count > MAX_POSES or received != (count, 3 * count, 4 * count):
        expected = f"K times, 3 K and 4 K numbers, with K at most {MAX_POSES}"
        raise InvalidInputError("poses", received, expected)
    return TimedPoses(
        times_s=np.array(message.times_s[:], np.float64),
        positions_m=np.array(message.positions_m[:], np.float64).reshape(-1, 3),
        quats_xyzw=np.array(message.quats_xyzw[:], np.float64).reshape(-1, 4),
    )


_TRAJECTORY = RecordConversion(
    PlannedTrajectory, pb.Trajectory, poses=Conversion(poses_to_proto, poses_from_proto)
)
trajectory_to_proto, trajectory_from_proto = _TRAJECTORY.to_proto, _TRAJECTORY.from_proto


def outline_to_header(outline: DriveOutline, instant_count: int) -> pb.DriveHeader:
    """Return the header of a drive; inverse: `outline_from_header`."""
    return pb.DriveHeader(
        trajectory=outline.trajectory,
        batch_id=outline.batch_id,
        start_ns=outline.start_ns,
        end_ns=outline.end_ns,
        counts=counts_to_proto(outline.due, {}),
        instant_count=instant_count,
    )


def outline_from_header(header: pb.DriveHeader) -> DriveOutline:
    """Return the outline of a drive."""
    return DriveOutline(
        trajectory=header.trajectory,
        batch_id=header.batch_id,
        start_ns=header.start_ns,
        end_ns=header.end_ns,
        due={count.sensor: count.due for count in header.counts},
    )


def counts_to_proto(due: Mapping[str, int], sent: Mapping[str, int]) -> list[pb.DriveCount]:
    """Return the messages of counts by sensor."""
    return [pb.DriveCount(sensor=name, due=n, sent=sent.get(name, 0)) for name, n in due.items()]


_IMU = RecordConversion(
    ImuReading, pb.ImuMeasurement, angular_rate_rad_s=VECTOR, specific_force_m_s2=VECTOR
)
_INSTANT = RecordConversion(
    DriveInstant,
    pb.DriveInstant,
    without="sample",
    pose=POSE,
    velocity_m_s=VECTOR,
    angular_rate_rad_s=VECTOR,
    imus=each(_IMU),
    odometry=ODOMETRY,
)
"""An instant, whose sample travels by itself."""

instant_to_proto, instant_from_proto = _INSTANT.to_proto, _INSTANT.from_proto


def measurement_counts(end: pb.DriveEnd) -> dict[str, int]:
    """Return how many measurements of each sensor were sent.

    Raises:
        OaisysError: More were sent than were due.
    """
    for count in end.counts:
        if count.sent > count.due:
            raise OaisysError(f"{count.sent} measurements of {count.sensor} for {count.due} due")
    return {count.sensor: count.sent for count in end.counts}
