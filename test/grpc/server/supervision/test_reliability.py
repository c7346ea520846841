"""Faults injected into a running server, its worker or its client; see docs/reliability.md."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc
import numpy as np
import psutil
import pytest
from attacks import code_and_details, own_channel
from grpc_health.v1 import health_pb2, health_pb2_grpc
from served_simulator import FLAT_WORLD, ROCKY_WORLD, Server, code_of
from waiting import PATIENCE_S, wait_until, within

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import (
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Pose, Progress, Sample
from oaisys_grpc.client.channel import SERVICE
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.operation import State
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc

StartServer = Callable[..., Server]
POSES = [pose_looking_down(1, 1, 11, 0.4), pose_looking_at((-6, -5, 7), (2, 3, 0))]
LONGER_THAN_ANY_TEST_S = 2 * PATIENCE_S
FAULTY = {"OAISYS_TEST_BUILD": "1"}
MEGABYTE = 1e6
CALL_END_S = 2.0
"""The bound of rows 1 and 8: a lost worker's call has ended, a lost client's slot is free."""
DEADLINE_S, GRACE_S = 1.0, 0.5


def labels_of(sample: Sample) -> list[bytes]:
    return [f.data.tobytes() for f in sample.frames if f.modality != "rgb"]


def control_run(poses: list[Pose], batches: int = 1) -> list[Sample]:
    """The samples of the last batch of an undisturbed run; all batches have one stage."""
    simulation = Simulation(config_from_mapping(ROCKY_WORLD))
    for index in range(batches):
        simulation.step_batch(reuse_stage=index > 0)
    return [simulation.step_sample(ModuleMetadata(sensor={"pose": pose})) for pose in poses]


def render_slowly(client: SimulatorClient, pose: Pose, begun: threading.Event) -> Sample:
    """Render a sample that a fault makes slow; set ``begun`` once the worker is at it."""

    def listen(progress: Progress) -> None:
        if progress.stage == "fault":
            begun.set()

    return client.render_sample(pose, on_progress=listen)


@contextmanager
def health_asked_all_the_time(address: str) -> Iterator[list[int]]:
    """Collect the answers of health; one that does not come is an error."""
    answers: list[int] = []
    ended = threading.Event()

    def ask() -> None:
        with grpc.insecure_channel(address) as channel:
            health = health_pb2_grpc.HealthStub(channel)
            while not ended.wait(0.1):
                request = health_pb2.HealthCheckRequest(service=SERVICE)
                answers.append(health.Check(request, timeout=PATIENCE_S).status)

    with ThreadPoolExecutor(1) as pool:
        asking = pool.submit(ask)
        try:
            yield answers
        finally:
            ended.set()
            asking.result()


def lost_in_a_render(
    server: Server, client: SimulatorClient, number: signal.Signals
) -> WorkerLostError:
    """End the worker while it renders `POSES[1]`; return what the caller gets."""
    with ThreadPoolExecutor() as pool:
        begun = threading.Event()
        killed = pool.submit(render_slowly, client, POSES[1], begun)
        assert begun.wait(PATIENCE_S)
        worker = server.worker()
        with within(CALL_END_S):
            worker.send_signal(number)
            with pytest.raises(WorkerLostError, match=number.name) as lost:
                killed.result(PATIENCE_S)
        client.wait_ready(PATIENCE_S)
        assert server.worker().pid != worker.pid
    return lost.value


def test_a_worker_that_dies_in_a_render_is_replaced_and_goes_on_as_if_nothing_had_happened(
    start_server: StartServer,
) -> None:
    control = control_run([POSES[0], *POSES], batches=2)
    fault = f"slow:{LONGER_THAN_ANY_TEST_S}@2"
    server = start_server(ROCKY_WORLD, OAISYS_FAULT=fault, **FAULTY)
    with server.client() as client:
        client.step_batch()
        client.step_batch(reuse_stage=True)
        client.render_sample(POSES[0])
        for restarts, number in enumerate((signal.SIGKILL, signal.SIGSEGV), start=1):
            error = lost_in_a_render(server, client, number)
            assert code_of(error) is grpc.StatusCode.ABORTED
            is_kill = number is signal.SIGKILL  # of which nobody else would know whose it was
            assert ("was ended by SIGKILL (sent by the system" in str(error)) == is_kill
            assert client.info().worker_restarts == restarts
            sample, expected = client.render_sample(POSES[restarts - 1]), control[restarts]
            assert (sample.batch_id, sample.sample_id) == (2, 1 + restarts)
            assert (sample.rig_pose, sample.provenance) == (expected.rig_pose, expected.provenance)
            assert labels_of(sample) == labels_of(expected)
    server.end()
    assert "what workers print: " in server.stderr.read_text()


def test_a_crash_loop_ends_and_nothing_spins(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT="crash", **FAULTY)
    with server.client() as client:
        for number in range(3):
            with own_channel(server.address) as channel:
                stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
                step = pb.StepBatchRequest(reuse_stage=number > 0)
                batch = stub.StepBatch(step).operation.name
                *_, status = client.watch_operation(batch)
                assert status.state is State.SUCCEEDED
                code, details = code_and_details(stub.RenderSample(pb.RenderSampleRequest()))
                assert code is grpc.StatusCode.ABORTED
                assert re.search(r"Aborted.*fault_injection\.py", details)
        wait_until(lambda: not client.is_ready(PATIENCE_S))
        process = psutil.Process(server.process.pid)
        used_s = sum(process.cpu_times()[:2])
        end_s = time.monotonic() + 2.0
        while time.monotonic() < end_s:
            assert not process.children()
            time.sleep(0.1)
        assert sum(process.cpu_times()[:2]) - used_s < 1.0
        with pytest.raises(OaisysError, match=r"no worker runs any more.*SIGABRT") as refused:
            client.render_sample(POSES[0])
        assert code_of(refused.value) is grpc.StatusCode.FAILED_PRECONDITION
        assert client.info().worker_restarts == 2
    (log,) = server.stderr.parent.glob("state/oaisys/worker-127.0.0.1-*.log")
    assert log.read_text().count("in _step_sample") == 3


def test_a_stopped_worker_is_killed_after_the_deadline_while_health_answers(
    start_server: StartServer,
) -> None:
    """The server cannot even send a large request to the end; it must not wait for that."""
    server = start_server(ROCKY_WORLD, "--grace", f"{GRACE_S}")
    with (
        server.client() as client,
        SimulatorClient(server.address, timeout_s=DEADLINE_S) as hasty,
        health_asked_all_the_time(server.address) as answers,
    ):
        client.step_batch()
        before = client.render_sample(POSES[0])
        for count, text_bytes in enumerate((10, 2_000_000), start=1):
            worker = server.worker()
            worker.suspend()
            metadata = ModuleMetadata(custom={"nothing": "x" * text_bytes})
            with within(DEADLINE_S + GRACE_S):
                with pytest.raises(DeadlineExceededError):
                    hasty.render_sample(POSES[1], metadata=metadata)
                psutil.wait_procs([worker], PATIENCE_S)
            assert not worker.is_running()
            after = client.render_sample()
            assert (after.sample_id, labels_of(after)) == (1 + count, labels_of(before))
    assert set(answers) <= {
        health_pb2.HealthCheckResponse.SERVING,
        health_pb2.HealthCheckResponse.NOT_SERVING,
    }


def test_a_worker_that_grows_is_replaced_between_two_frames(start_server: StartServer) -> None:
    poses = [pose_looking_down(i / 2, -i / 2, 10 + i / 10) for i in range(4)]
    expected = control_run(poses)
    options = ("--worker-memory-limit-mb", "800")
    server = start_server(ROCKY_WORLD, *options, OAISYS_FAULT="leak:250", **FAULTY)
    workers: list[int] = []
    with server.client() as client, health_asked_all_the_time(server.address) as answers:
        client.step_batch()
        begin = len(answers)
        samples = []
        for pose in poses:
            samples.append(client.render_sample(pose))
            workers.append(server.worker().pid)
        assert client.info().worker_restarts == 0
    assert len(set(workers)) >= 2
    assert [s.sample_id for s in samples] == list(range(1, len(poses) + 1))
    assert [labels_of(s) for s in samples] == [labels_of(s) for s in expected]
    assert set(answers[begin:]) == {health_pb2.HealthCheckResponse.SERVING}


@pytest.mark.long
def test_a_worker_that_grows_within_a_frame_is_killed(start_server: StartServer) -> None:
    fault = f"leak:1200@1,slow:{LONGER_THAN_ANY_TEST_S}@1"
    options = ("--worker-memory-limit-mb", "600")
    server = start_server(ROCKY_WORLD, *options, OAISYS_FAULT=fault, **FAULTY)
    with server.client() as client:
        client.step_batch()
        with pytest.raises(WorkerLostError, match="MB of memory"):
            client.render_sample(POSES[0])


CLIENT = """
import sys
from oaisys_grpc.client.simulator_client import SimulatorClient
SimulatorClient(sys.argv[1]).render_sample(on_progress=lambda p: print(p.stage, flush=True))
"""


@pytest.mark.long
def test_after_a_deadline_or_the_end_of_a_client_the_worker_is_free_and_nothing_stale_comes(
    start_server: StartServer,
) -> None:
    fault = f"slow:{LONGER_THAN_ANY_TEST_S}@2,slow:{LONGER_THAN_ANY_TEST_S}@5"
    server = start_server(FLAT_WORLD, OAISYS_FAULT=fault, **FAULTY)
    with server.client() as client, SimulatorClient(server.address, timeout_s=0.5) as hasty:
        client.step_batch()
        client.render_sample(POSES[0])
        with pytest.raises(DeadlineExceededError) as late:
            hasty.render_sample(POSES[1])
        assert code_of(late.value) is grpc.StatusCode.DEADLINE_EXCEEDED
        for sample_id, height_m in ((2, 6.0), (3, 8.0)):
            sample = client.render_sample(pose_looking_down(2, 3, height_m))
            assert (sample.sample_id, sample.rig_pose.position_m) == (sample_id, (2, 3, height_m))
            np.testing.assert_allclose(sample.frame("camera", "depth").data, height_m, rtol=1e-5)
        with pytest.raises(NotFoundError):
            client.get_sample(1, 4)
        other = subprocess.Popen(
            [sys.executable, "-c", CLIENT, server.address], stdout=subprocess.PIPE, text=True
        )
        with other:
            assert other.stdout is not None
            assert any(line.strip() == "fault" for line in other.stdout)
            with within(CALL_END_S):
                other.kill()
                sample = client.render_sample(POSES[0])
        assert sample.sample_id == 4
        assert client.info().worker_restarts == 0


@pytest.mark.parametrize(
    ("factor", "accepted"),
    [(1.009, True), (0.991, True), (1.02, False), (0.98, False), (0, False)],
)
def test_a_quaternion_almost_of_unit_norm_is_normalised(
    flat_client: SimulatorClient, factor: float, accepted: bool
) -> None:
    pose = pose_looking_at((-3, 1, 6), (2, -1, 0))
    x, y, z, w = (factor * component for component in pose.quat_xyzw)
    scaled = Pose(pose.position_m, (x, y, z, w))
    if accepted:
        sample, same = flat_client.render_sample(scaled), flat_client.render_sample(pose)
        assert np.linalg.norm(sample.rig_pose.quat_xyzw) == pytest.approx(1, abs=1e-12)
        np.testing.assert_allclose(sample.rig_pose.quat_xyzw, pose.quat_xyzw, atol=1e-12)
        depth_m, same_m = (s.frame("camera", "depth").data for s in (sample, same))
        np.testing.assert_allclose(depth_m, same_m, rtol=1e-5)
    else:
        with pytest.raises(InvalidInputError, match="unit quaternion"):
            flat_client.render_sample(scaled)


def test_poses_under_the_ground_and_outside_the_world(flat_client: SimulatorClient) -> None:
    under, outside = pose_looking_down(1, 2, -3), pose_looking_down(50, 0, 5)
    clamp, allow = ({"sensor": {"pose_policy": policy}} for policy in ("clamp", "allow"))
    before = flat_client.info().sample_id
    for pose, said in ((under, "clearance.*3.000 m under"), (outside, "stage")):
        with pytest.raises(InvalidInputError, match=said):
            flat_client.render_sample(pose)
    assert flat_client.info().sample_id == before
    clamped = [
        flat_client.render_sample(p, metadata=ModuleMetadata(**clamp)).rig_pose.position_m
        for p in (under, outside)
    ]
    x, y, z = clamped[0]
    assert (x, y) == (1, 2)
    assert 0 < z < 1
    x, y, _ = clamped[1]
    assert (x, y) == (pytest.approx(20, abs=0.5), 0)
    for pose in (under, outside):
        allowed = flat_client.render_sample(pose, metadata=ModuleMetadata(**allow))
        assert allowed.rig_pose == pose


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"stage": {"resolution_px": -3}}, r"world\.yaml:\d+: stage\.resolution_px.*-3"),
        (
            {"materials": {"layers": [{"label": "a", "semantic_id": 1, "folder": "nowhere"}]}},
            r"world\.yaml:\d+: materials\.layers\.0.*nowhere",
        ),
    ],
    ids=["malformed", "missing"],
)
def test_a_world_that_cannot_be_is_exit_2_with_its_place(
    start_server: StartServer, section: dict[str, object], said: str
) -> None:
    server = start_server({**FLAT_WORLD, **section})
    assert server.process.wait(PATIENCE_S) == 2
    (line,) = server.stderr.read_text().splitlines()
    assert re.search(said, line)
