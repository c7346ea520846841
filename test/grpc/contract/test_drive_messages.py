"""Trajectories and drives as messages come back as they were."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import (
    DriveInstant,
    DriveOutline,
    GroupCount,
    ImuInfo,
    ImuReading,
    Odometry,
    PlannedTrajectory,
    Pose,
    SimulatorInfo,
    TimedPoses,
)
from oaisys_grpc.contract.drive_messages import (
    MAX_POSES,
    counts_to_proto,
    instant_from_proto,
    instant_to_proto,
    measurement_counts,
    outline_from_header,
    outline_to_header,
    poses_from_proto,
    trajectory_from_proto,
    trajectory_to_proto,
)
from oaisys_grpc.contract.world_messages import info_from_proto, info_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

RNG = np.random.default_rng(4)
POSES = TimedPoses(np.arange(5.0), RNG.normal(size=(5, 3)), RNG.normal(size=(5, 4)))
PLANNED = PlannedTrajectory(
    "trajectories/1", POSES, 3.5, 12.25, 1.624, 50.0, "a rock at (1, 2)", "{}"
)
READING = ImuReading("imu", (0.1, -0.2, 0.3), (0.0, 1e-9, 9.81))
POSE = Pose((1.0, -2.0, 3.0), (0.0, 0.6, 0.0, 0.8))


def test_a_planned_trajectory_comes_back_as_it_was() -> None:
    back = trajectory_from_proto(trajectory_to_proto(PLANNED))
    for name in ("times_s", "positions_m", "quats_xyzw"):
        np.testing.assert_array_equal(getattr(back.poses, name), getattr(POSES, name))
    assert replace(back, poses=POSES) == PLANNED


@pytest.mark.parametrize(
    "instant",
    [
        DriveInstant(7, POSE, (1.0, 0.5, -0.1), (0.01, 0.02, 0.03)),
        DriveInstant(
            time_ns=10**18,
            pose=POSE,
            velocity_m_s=(0.0, 0.0, 0.0),
            angular_rate_rad_s=(0.0, 0.0, 0.0),
            has_odometry=True,
            odometry=Odometry(POSE, 0.25, 0.5),
            imus=(READING,),
            sensors=("front", "lidar"),
        ),
    ],
)
def test_an_instant_comes_back_as_it_was(instant: DriveInstant) -> None:
    assert instant_from_proto(instant_to_proto(instant)) == instant


def test_outline_counts_and_imus_come_back_as_they_were() -> None:
    outline = DriveOutline("trajectories/1", 4, -5, 10**10, {"front": 3, "odometry": 0})
    header = outline_to_header(outline, 17)
    assert outline_from_header(header) == outline
    assert header.instant_count == 17
    end = pb.DriveEnd(counts=counts_to_proto({"front": 3, "imu": 9}, {"imu": 8}))
    assert measurement_counts(end) == {"front": 0, "imu": 8}
    end.counts[1].sent = 10
    with pytest.raises(OaisysError, match="imu"):
        measurement_counts(end)
    imu = ImuInfo("imu", np.arange(16.0).reshape(4, 4), 200.0, 0.5, 0.25)
    info = SimulatorInfo("analytic", "1", 0, "", "preview", (), {}, 1, 0, None, imus=(imu,))
    info = replace(info, group_counts=(GroupCount("grass", 9, 7),))
    (back,) = info_from_proto(info_to_proto(info)).imus
    assert info_from_proto(info_to_proto(info)).group_counts == info.group_counts
    np.testing.assert_array_equal(back.T_base_imu, imu.T_base_imu)
    assert (back.name, *astuple(back)[2:]) == (imu.name, *astuple(imu)[2:])


@pytest.mark.parametrize(("times", "positions"), [(2, 5), (2, 7), (MAX_POSES + 1, 0)])
def test_poses_that_do_not_fit_together_are_refused(times: int, positions: int) -> None:
    message = pb.TimedPoses(times_s=[0.0] * times, positions_m=[0.0] * positions)
    message.quats_xyzw.extend([0.0] * (4 * times))
    with pytest.raises(InvalidInputError) as caught:
        poses_from_proto(message)
    assert caught.value.field == "poses"
