"""Timed drives over gRPC: all due measurements come, in order of time, equal to the core's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from driven_world import DRIVEN_WORLD, DUE
from served_simulator import Server, code_of, stepped_server

from oaisys_core.config import config_from_mapping
from oaisys_core.drive.drive import Drive
from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    NotReadyError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.geometry import pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import DriveInstant, ModuleMetadata, TimedPoses
from oaisys_grpc.client.simulator_client import DriveStream, SimulatorClient
from oaisys_grpc.contract.faults import OvertakenError
from oaisys_grpc.contract.metadata import struct_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb

RISE = TimedPoses(
    times_s=np.array((5.0, 6.0, 8.0)),
    positions_m=np.array([(1.0, 2.0, 8.0), (1.0, 2.0, 9.0), (1.0, 2.0, 11.0)]),
    quats_xyzw=np.tile((0.0, 0.0, 0.0, 1.0), (3, 1)),
)
"""1 m/s upwards from 5 s to 8 s."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with stepped_server(tmp_path_factory.mktemp("drive") / "server", DRIVEN_WORLD) as running:
        yield running


@pytest.fixture
def client(server: Server) -> Iterator[SimulatorClient]:
    with server.client() as client:
        yield client


def test_a_drive_brings_everything_that_is_due_as_the_core_makes_it(server: Server) -> None:
    config = config_from_mapping(DRIVEN_WORLD)
    simulation = Simulation(config)
    simulation.step_batch(seed=3)
    expected = Drive(simulation, config)
    views = {view.time_ns: view for view in expected.samples()}
    odometry, imu = expected.odometry(), expected.imu_measurements("imu")
    fractions: list[float] = []
    with SimulatorClient(server.address, timeout_s=60) as client:
        client.step_batch(seed=3)
        planned = client.set_trajectory()
        with client.drive(
            planned.name, on_progress=lambda progress: fractions.append(progress.fraction)
        ) as drive:
            assert (drive.outline.start_ns, drive.outline.end_ns) == (0, 10**9)
            assert drive.outline.due == DUE
            instants = list(drive)
        assert drive.counts == drive.received == DUE
        assert client.info().imus[0].T_base_imu[:3, 3].tolist() == [0.1, 0.0, 0.3]
    np.testing.assert_array_equal(planned.poses.positions_m, expected.plan.trajectory.positions_m)
    assert (planned.end_s, planned.gravity_m_s2) == (1.0, 1.624)
    assert planned.length_m == pytest.approx(expected.plan.length_m())
    assert all(a.time_ns < b.time_ns for a, b in pairwise(instants))
    assert {i.time_ns: i.sensors for i in instants if i.sensors} == {
        time_ns: view.sensors for time_ns, view in views.items()
    }
    for instant in instants:
        if instant.sample is None:
            continue
        wanted = views[instant.time_ns].sample
        assert instant.sample.rig_pose == wanted.rig_pose
        for frame in wanted.frames:
            found = instant.sample.frame(frame.sensor, frame.modality)
            np.testing.assert_array_equal(found.data, frame.data)
        assert [s.data.tobytes() for s in instant.sample.scans] == [
            s.data.tobytes() for s in wanted.scans
        ]
    measured = [reading for instant in instants for reading in instant.imus]
    np.testing.assert_array_equal([r.angular_rate_rad_s for r in measured], imu.angular_rate_rad_s)
    np.testing.assert_array_equal(
        [r.specific_force_m_s2 for r in measured], imu.specific_force_m_s2
    )
    at = [instant for instant in instants if instant.has_odometry]
    np.testing.assert_array_equal([i.velocity_m_s for i in at], odometry.velocity_m_s)
    np.testing.assert_array_equal([i.pose.quat_xyzw for i in at], odometry.quats_xyzw)
    assert fractions == sorted(fractions)
    simulation.close()


def test_poses_with_times_are_followed_and_sensors_can_be_chosen(client: SimulatorClient) -> None:
    planned = client.set_trajectory(RISE, drive={"odometry_rate_hz": 2, "duration_s": 2})
    assert (planned.end_s, planned.length_m) == (7.0, pytest.approx(2.0))
    metadata = ModuleMetadata(sensor={"faults": {"enabled": False}})
    with client.drive(sensors=["side", "odometry"], metadata=metadata) as drive:
        instants = list(drive)
    assert drive.received == drive.outline.due == {"side": 8, "odometry": 4}
    for instant in instants:
        assert instant.pose.position_m[2] == pytest.approx(8 + instant.time_ns / 1e9 - 5)
        assert instant.velocity_m_s == pytest.approx((0, 0, 1), abs=1e-9)
    assert [i.time_ns / 1e9 for i in instants if i.has_odometry] == [5.0, 5.5, 6.0, 6.5]


def test_odometry_drifts_as_the_trajectory_says(client: SimulatorClient) -> None:
    far_too_long = {"odometry_drift": {"scale_error": 0.5}, "odometry_rate_hz": 2}
    client.set_trajectory(RISE, drive=far_too_long)
    with client.drive(sensors=["odometry"]) as drive:
        instants = list(drive)
    for instant in instants:
        assert instant.odometry is not None
        risen_m = instant.pose.position_m[2] - 8.0
        assert instant.odometry.pose.position_m[2] == pytest.approx(8.0 + 1.5 * risen_m)
    assert risen_m > 2
    client.set_trajectory(RISE)
    with client.drive(sensors=["odometry"]) as drive:
        assert all(instant.odometry is None for instant in drive)


def for_each(drive: DriveStream, action: Callable[[DriveInstant], object]) -> None:
    for instant in drive:
        action(instant)


def refused(call: Callable[[], object]) -> InvalidInputError:
    with pytest.raises(InvalidInputError) as caught:
        call()
    return caught.value


def test_what_cannot_be_driven_is_refused_with_its_field(client: SimulatorClient) -> None:
    def drive(**options: Any) -> Callable[[], object]:
        def call() -> None:
            with client.drive(**options):
                pass

        return call

    short = TimedPoses(RISE.times_s[:2], RISE.positions_m, RISE.quats_xyzw)
    assert refused(lambda: client.set_trajectory(short)).field == "poses"
    backwards = TimedPoses(RISE.times_s[::-1], RISE.positions_m, RISE.quats_xyzw)
    assert refused(lambda: client.set_trajectory(backwards)).field == "trajectory.times_s.1"
    both = refused(lambda: client.set_trajectory(RISE, drive={"waypoints_m": [[0, 0]]}))
    assert both.field == "drive.waypoints_m"
    unknown = refused(lambda: client.set_trajectory(drive={"speed": 3}))
    assert unknown.field == "drive.speed"
    away = refused(lambda: client.set_trajectory(drive={"waypoints_m": [[0, 0], [90, 0]]}))
    assert "on the stage" in away.expected
    passwd = {"vehicle": {"kind": "file", "path": "/etc/passwd"}}
    outside = refused(lambda: client.set_trajectory(drive=passwd))
    assert outside.field.startswith("drive.vehicle")
    assert "asset roots" in outside.expected
    hover = {"vehicle": {"kind": "drone", "hover_s": 1500}, "waypoints_m": [[0, 0, 9], [1, 0, 9]]}
    assert "50000" in refused(lambda: client.set_trajectory(drive=hover)).expected

    client.set_trajectory()
    assert refused(drive(sensors=["fron"])).field == "sensors"
    posed = ModuleMetadata(sensor={"pose": pose_looking_down(0, 0, 5)})
    assert refused(drive(metadata=posed)).field == "metadata.sensor.pose"
    with pytest.raises(NotFoundError):
        drive(trajectory="trajectories/none")()
    long = TimedPoses(np.array((0.0, 1e6)), RISE.positions_m[:2], RISE.quats_xyzw[:2])
    client.set_trajectory(long)
    assert refused(drive()).field == "drive.duration_s"


def test_a_pose_in_the_ground_ends_the_drive_after_what_came_before(
    client: SimulatorClient,
) -> None:
    into_the_ground_m = np.array([(1.0, 2.0, 8.0), (1.0, 2.0, 4.0), (1.0, 2.0, -20.0)])
    sink = TimedPoses(RISE.times_s, into_the_ground_m, RISE.quats_xyzw)
    client.set_trajectory(sink, drive={"odometry_rate_hz": 1})
    came: list[DriveInstant] = []
    with (
        client.drive(sensors=["front", "odometry"]) as drive,
        pytest.raises(InvalidInputError, match="clearance"),
    ):
        came.extend(drive)
    assert came
    assert 0 < drive.counts["front"] == drive.received["front"] < drive.outline.due["front"]


def test_a_drive_that_is_left_frees_the_worker_and_keeps_it(
    server: Server, client: SimulatorClient
) -> None:
    worker = server.worker()
    client.set_trajectory(RISE)
    with client.drive(sensors=["front"]) as drive:
        assert next(iter(drive)).sample is not None
    with client.drive(sensors=["front"]) as drive, pytest.raises(CancelledError):
        for_each(drive, lambda _: drive.cancel())
    assert client.render_sample(pose_looking_down(1, 2, 9)).frames
    assert server.worker() == worker


def test_others_render_between_two_samples_of_a_drive(
    server: Server, client: SimulatorClient
) -> None:
    client.set_trajectory(RISE)
    above = pose_looking_down(1, 2, 9)
    with client.drive(sensors=["front"]) as drive, server.client() as other:
        instants = iter(drive)
        first = next(instants)
        between = other.render_sample(above)
        rest = list(instants)
    ids = [i.sample.sample_id for i in (first, *rest) if i.sample is not None]
    assert len(ids) == 30
    assert between.sample_id not in ids
    assert between.sample_id > ids[0]


def test_a_new_world_ends_a_drive(server: Server, client: SimulatorClient) -> None:
    long = TimedPoses(np.array((0.0, 3e4)), RISE.positions_m[:2], RISE.quats_xyzw[:2])
    client.set_trajectory(long)

    def replace_world(_: DriveInstant) -> None:
        if drive.received["front"] == 2:
            other.step_batch(seed=3)

    with (
        client.drive(sensors=["front"]) as drive,
        server.client() as other,
        pytest.raises(OvertakenError),
    ):
        for_each(drive, replace_world)
    assert drive.counts["front"] >= 2


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        pytest.param("crash-once", WorkerLostError, marks=pytest.mark.long),
        pytest.param("slow", DeadlineExceededError, marks=pytest.mark.soak),
    ],
)
def test_an_interrupted_drive_says_why_and_the_next_one_is_whole(
    fault: str,
    error: type[OaisysError],
    start_server: Callable[..., Server],
    tmp_path: Path,
) -> None:
    """The fourth sample crashes its worker, or takes longer than the drive may."""
    amount = f"{tmp_path / 'crashed'}" if fault == "crash-once" else "240"
    environment = {"OAISYS_FAULT": f"{fault}:{amount}@4", "OAISYS_TEST_BUILD": "1"}
    with start_server(DRIVEN_WORLD, **environment).client() as client:
        client.step_batch(seed=3)
        client.set_trajectory(RISE)
        timeout_s = 4.0 if fault == "slow" else None
        with client.drive(sensors=["front"], timeout_s=timeout_s) as drive, pytest.raises(error):
            for_each(drive, lambda _: None)
        assert drive.received["front"] <= 3
        with client.drive(sensors=["front", "imu"]) as drive:
            instants = list(drive)
    assert drive.received == {"front": 30, "imu": 300}
    assert len(instants) == 300


@pytest.mark.long
def test_a_server_without_trajectory_or_drive_says_what_is_missing(
    start_server: Callable[..., Server],
) -> None:
    world = {key: value for key, value in DRIVEN_WORLD.items() if key != "drive"}
    with start_server(world).client() as client:
        with pytest.raises(NotReadyError, match="SetTrajectory"), client.drive():
            pass
        with pytest.raises(NotReadyError, match="StepBatch"):
            client.set_trajectory(drive={"waypoints_m": [[0, 0], [3, 0]]})
        client.step_batch()
        assert refused(client.set_trajectory).field == "drive"
        assert client.set_trajectory(drive={"waypoints_m": [[0, 0], [3, 0]]}).length_m > 2.9
        # More names than any rig has are refused before anything is drawn.
        stub: Any = client._channel._stub
        request = pb.DriveRequest(sensors=["front"] * 2000)
        with pytest.raises(grpc.RpcError, match="2000 names"):
            list(stub.Drive(request))
        endless = pb.SetTrajectoryRequest(drive=struct_to_proto({"duration_s": 0}, "drive"))
        with pytest.raises(grpc.RpcError, match="duration_s"):
            stub.SetTrajectory(endless)


def test_a_refused_drive_has_the_status_of_its_error(client: SimulatorClient) -> None:
    client.set_trajectory(RISE)
    with pytest.raises(NotFoundError) as caught, client.drive("trajectories/none"):
        pass
    assert code_of(caught.value).name == "NOT_FOUND"
