"""What a worker does for timed drives: plans trajectories, lists instants, poses the rig.

Must not import gRPC.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.drive import DriveConfig, OdometryDriftConfig
from oaisys_core.drive.drive import Drive
from oaisys_core.drive.instants import DriveTimes
from oaisys_core.drive.schedule import NANOSECONDS
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory import RigMotion, Trajectory
from oaisys_core.trajectory.planning import (
    WAY_KEYS,
    DrivePlan,
    change_drive,
    plan_along,
    plan_drive,
)
from oaisys_core.types import DriveOutline, ModuleMetadata, PlannedTrajectory, TimedPoses
from oaisys_grpc.contract.drive_messages import (
    MAX_POSES,
    instant_to_proto,
    outline_to_header,
    poses_from_proto,
    trajectory_to_proto,
)
from oaisys_grpc.contract.faults import OvertakenError, UnknownTrajectoryError
from oaisys_grpc.contract.metadata import metadata_from_proto, names, struct_from_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb


class TimedView(NamedTuple):
    """A sample of a drive.

    Attributes:
        metadata: With the pose of the rig.
        sensors: The cameras and lidars that are due.
        motion: Motion of the rig while they measure.
    """

    metadata: ModuleMetadata
    sensors: tuple[str, ...]
    motion: RigMotion | None


class _CurrentDrive(NamedTuple):
    """The drive of the last call."""

    key: tuple[object, ...]
    drive: Drive
    times: DriveTimes


class DriveCalls:
    """Answers calls about drives; keeps what it has computed of the last one.

    Args:
        simulation: The simulation.
        config: Its configuration.
    """

    def __init__(self, simulation: Simulation, config: SimulationConfig) -> None:
        self._simulation = simulation
        self._config = config
        self._current: _CurrentDrive | None = None

    def plan(self, request: pb.SetTrajectoryRequest) -> pb.Trajectory:
        """Plan a trajectory in the current world.

        Raises:
            InvalidInputError: It cannot be driven, or has more than `MAX_POSES` poses.
        """
        changes = struct_from_proto(request.drive)
        if request.HasField("poses"):
            plan = _plan_of(poses_from_proto(request.poses), self._config.drive, changes)
        else:
            if not changes and self._config.drive is None:
                expected = "drive or poses: the configuration has no section drive"
                raise InvalidInputError("drive", None, expected)
            section = change_drive(self._config.drive, changes)
            heights = partial(self._simulation.query_height, on_stage=True)
            info = self._simulation.info()
            plan = plan_drive(section, heights, info.sensors, info.georeference)
        count = len(plan.trajectory.times_s)
        if count > MAX_POSES:
            expected = f"a trajectory of at most {MAX_POSES} poses"
            raise InvalidInputError("drive", f"one of {count}", expected)
        return trajectory_to_proto(_describe(plan))

    def header(self, step: pb.DriveStep) -> pb.DriveHeader:
        """Return what a drive will consist of."""
        drive, times = self._drive(step)
        outline = DriveOutline(
            trajectory=step.trajectory.name,
            batch_id=self._simulation.info().batch_id,
            start_ns=round(drive.plan.trajectory.start_s * NANOSECONDS),
            end_ns=round(drive.plan.end_s * NANOSECONDS),
            due=drive.schedule.counts,
        )
        return outline_to_header(outline, len(times))

    def instants(self, step: pb.DriveStep) -> pb.DriveInstants:
        """Return some instants of a drive."""
        _, times = self._drive(step)
        found = times.instants(step.first, step.count)
        return pb.DriveInstants(instants=map(instant_to_proto, found))

    def view(self, step: pb.DriveStep) -> TimedView:
        """Return the sample that is due at a time."""
        drive, _ = self._drive(step)
        metadata = drive.metadata_at(step.time_ns)
        if step.HasField("metadata"):
            metadata = metadata_from_proto(step.metadata).with_update(metadata)
        return TimedView(
            metadata,
            tuple(step.due),
            drive.motion_about(step.time_ns, step.due),
        )

    def _drive(self, step: pb.DriveStep) -> tuple[Drive, DriveTimes]:
        """Return the drive that a call is about.

        Raises:
            OvertakenError: Another world was built since the drive began.
            UnknownTrajectoryError: It is another drive, and the trajectory came without its poses.
        """
        batch_id = self._simulation.info().batch_id
        if step.batch_id not in (0, batch_id):
            raise OvertakenError(f"batch {batch_id} has replaced batch {step.batch_id}")
        key = (step.trajectory.name, tuple(step.sensors), batch_id)
        if self._current is None or self._current.key != key:
            self._current = None
            if not step.trajectory.HasField("poses"):
                raise UnknownTrajectoryError(f"{step.trajectory.name} came without its poses")
            chosen = names(step.sensors, "sensors")
            drive = Drive(self._simulation, self._config, _plan_from(step.trajectory), chosen)
            self._current = _CurrentDrive(key, drive, DriveTimes(drive))
        return self._current.drive, self._current.times


def _plan_of(
    poses: TimedPoses, configured: DriveConfig | None, changes: dict[str, object]
) -> DrivePlan:
    """Return the drive along poses; gravity, duration and odometry are as in a section ``drive``.

    Raises:
        InvalidInputError: The poses are none, or the changes name a vehicle or waypoints, too.
    """
    for key in ("vehicle", *WAY_KEYS):
        if key in changes:
            raise InvalidInputError(f"drive.{key}", changes[key], "no such key beside poses")
    trajectory = Trajectory(poses.times_s, poses.positions_m, poses.quats_xyzw)
    # A section without a way is no valid one.
    way = {"vehicle": {"kind": "rover"}, "waypoints_m": poses.positions_m[:1].tolist()}
    return plan_along(trajectory, change_drive(configured, {**changes, **way}))


def _describe(plan: DrivePlan) -> PlannedTrajectory:
    trajectory = plan.trajectory
    return PlannedTrajectory(
        name="",
        poses=TimedPoses(trajectory.times_s, trajectory.positions_m, trajectory.quats_xyzw),
        end_s=plan.end_s,
        length_m=plan.length_m(),
        gravity_m_s2=plan.gravity_m_s2,
        odometry_rate_hz=plan.odometry_rate_hz,
        obstacle="" if plan.obstacle is None else str(plan.obstacle),
        odometry_drift_json=plan.odometry_drift.model_dump_json(),
    )


def _plan_from(message: pb.Trajectory) -> DrivePlan:
    """Return the plan that `_describe` describes."""
    poses = poses_from_proto(message.poses)
    trajectory = Trajectory(poses.times_s, poses.positions_m, poses.quats_xyzw)
    return DrivePlan(
        trajectory=trajectory,
        end_s=message.end_s,
        gravity_m_s2=message.gravity_m_s2,
        odometry_rate_hz=message.odometry_rate_hz,
        odometry_drift=OdometryDriftConfig.model_validate_json(message.odometry_drift_json),
    )
