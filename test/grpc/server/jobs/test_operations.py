"""The queue: order, idempotency, cancelling, bounds; all while a worker is slow."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import grpc
import numpy as np
import pytest
from attacks import code_and_details, own_channel
from served_simulator import FLAT_WORLD, Server, code_of
from waiting import PATIENCE_S, wait_until

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    QueueFullError,
)
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata, Pose, Progress
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.errors import error_from_rpc
from oaisys_grpc.contract.faults import OvertakenError
from oaisys_grpc.contract.metadata_bounds import MAX_METADATA_BYTES
from oaisys_grpc.contract.operation import Kind, OperationStatus, State
from oaisys_grpc.contract.sample_messages import FrameMessage, SampleMessages
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.server.jobs.job import (
    MAX_BYTES,
    MAX_RECENT,
    MAX_SAMPLES,
    RECENT_S,
    Job,
    Operation,
    SampleStore,
)
from oaisys_grpc.server.jobs.queue import QUEUE_BYTES, QUEUE_LIMIT, OperationQueue
from oaisys_grpc.server.limits.slots import LIMITS, SHARE_OF_CONNECTION
from oaisys_grpc.server.options import ServerOptions
from oaisys_grpc.server.servicer import SimulatorServicer
from oaisys_grpc.server.supervision.supervisor import Supervisor

POSES = [pose_looking_down(-10 + i, 5 - i / 2, 4 + i / 4) for i in range(20)]


@pytest.fixture(scope="module")
def slow_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Each sample takes longer than any test waits, unless it is cancelled."""
    env = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": f"slow:{2 * PATIENCE_S:g}"}
    with Server(tmp_path_factory.mktemp("grpc") / "slow", FLAT_WORLD, **env) as server:
        yield server


@pytest.fixture
def slow_client(slow_server: Server) -> Iterator[SimulatorClient]:
    """A client of it; a batch stands and nothing waits."""
    with slow_server.client() as client:
        client.step_batch()
        yield client
        client.step_batch()  # overtakes what the test left behind


def rendering(client: SimulatorClient, name: str) -> OperationStatus:
    """Wait until the worker renders this operation."""
    return next(s for s in client.watch_operation(name) if s.progress.stage == "fault")


def ended(client: SimulatorClient, name: str) -> OperationStatus:
    *_, last = client.watch_operation(name)
    return last


def test_twenty_overlapping_calls_each_get_their_own_pose(flat_client: SimulatorClient) -> None:
    def depth_and_pose(pose: Pose) -> tuple[float, Pose]:
        sample = flat_client.render_sample(pose)
        return float(sample.frame("camera", "depth").data[24, 32]), sample.rig_pose

    with ThreadPoolExecutor(len(POSES)) as pool:
        answers = list(pool.map(depth_and_pose, POSES))
    assert [pose for _, pose in answers] == POSES
    heights_m = [pose.position_m[2] for pose in POSES]
    assert [depth_m for depth_m, _ in answers] == pytest.approx(heights_m, rel=1e-5)


def test_first_in_first_out(flat_client: SimulatorClient) -> None:
    first = flat_client.render_sample(POSES[0]).sample_id
    names = [flat_client.start_sample(pose) for pose in POSES]
    statuses = [ended(flat_client, name) for name in names]
    assert [s.sample_id for s in statuses] == list(range(first + 1, first + 21))
    newest = statuses[-1]
    assert flat_client.get_sample(newest.batch_id, newest.sample_id).rig_pose == POSES[-1]
    oldest = statuses[-1 - MAX_SAMPLES]
    time.sleep(RECENT_S)
    last = ended(flat_client, flat_client.start_sample(POSES[0]))
    with pytest.raises(NotFoundError, match="the last 16 are kept"):
        flat_client.get_sample(oldest.batch_id, oldest.sample_id)
    assert flat_client.get_sample(last.batch_id, last.sample_id - MAX_SAMPLES + 1).sample_id > 0


def test_a_repeated_request_is_one_render(flat_client: SimulatorClient) -> None:
    before = flat_client.render_sample(POSES[3]).sample_id
    names = {flat_client.start_sample(POSES[4], request_id="twice") for _ in range(2)}
    (name,) = names
    assert ended(flat_client, name).sample_id == before + 1
    assert flat_client.start_sample(POSES[4], request_id="twice") == name
    assert flat_client.info().sample_id == before + 1


def test_a_request_id_with_another_body_is_refused(flat_client: SimulatorClient) -> None:
    flat_client.start_sample(POSES[4], request_id="once")
    with pytest.raises(InvalidInputError) as refused:
        flat_client.start_sample(POSES[5], request_id="once")
    assert (refused.value.field, refused.value.received) == ("request_id", "once")
    with pytest.raises(InvalidInputError):
        flat_client.start_batch(request_id="once")


def test_a_request_id_of_another_client_refuses_nothing(
    flat_server: Server, flat_client: SimulatorClient
) -> None:
    first = flat_client.start_sample(POSES[4], request_id="mine too")
    with own_channel(flat_server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        request = pb.StepSampleRequest(request_id="mine too", modalities=["depth"])
        other = stub.StepSample(request).operation.name
        assert other != first
        assert stub.StepSample(request).operation.name == other
        parts = stub.RenderSample(pb.RenderSampleRequest(request_id="mine too"))
        assert code_and_details(parts)[0] is grpc.StatusCode.INVALID_ARGUMENT  # its own, changed
    assert flat_client.start_sample(POSES[4], request_id="mine too") == first
    assert ended(flat_client, first).sample_id != ended(flat_client, other).sample_id


def test_a_request_that_failed_may_be_sent_again(slow_client: SimulatorClient) -> None:
    first = slow_client.start_sample(POSES[0], request_id="again")
    assert slow_client.start_sample(POSES[0], request_id="again") == first
    slow_client.cancel_operation(first)
    second = slow_client.start_sample(POSES[0], request_id="again")
    assert second != first
    rendering(slow_client, second)
    assert slow_client.get_operation(first).state is State.CANCELLED
    with pytest.raises(InvalidInputError):
        slow_client.start_sample(POSES[1], request_id="again")


def test_names_of_another_server_are_not_known(
    flat_client: SimulatorClient, slow_client: SimulatorClient
) -> None:
    name = flat_client.start_sample(POSES[0])
    assert ended(flat_client, name).state is State.SUCCEEDED
    for stale in (name, "operations/1", "operations/2", ""):
        with pytest.raises(NotFoundError):
            slow_client.get_operation(stale)


def test_an_operation_that_nobody_watches_ends_at_its_deadline(
    slow_server: Server, slow_client: SimulatorClient
) -> None:
    with SimulatorClient(slow_server.address, timeout_s=0.5) as hasty:
        running, waiting = (hasty.start_sample(pose) for pose in POSES[:2])
    for name in (running, waiting):
        status = ended(slow_client, name)
        assert status.state is State.FAILED
        assert isinstance(status.error, DeadlineExceededError)
    assert slow_client.info().sample_id == 0


@pytest.mark.long
def test_the_seconds_left_are_known_from_work_done_before(
    start_server: Callable[..., Server],
) -> None:
    env = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": "slow:0.5"}
    with start_server(FLAT_WORLD, **env).client() as client:
        client.step_batch()
        first = list(client.watch_operation(client.start_sample(POSES[0])))
        assert all(status.progress.seconds_left is None for status in first)
        running, waiting = (client.start_sample(pose) for pose in POSES[1:3])
        rendering(client, running)
        queued = client.get_operation(waiting)
        now = client.get_operation(running)
        assert queued.progress.seconds_left is not None
        if now.state is State.RUNNING:
            assert now.progress.seconds_left is not None
            assert 0 <= now.progress.seconds_left <= queued.progress.seconds_left
        assert ended(client, waiting).progress == Progress("done", 1.0)


def test_many_streams_leave_room_for_calls_that_answer_at_once(
    slow_server: Server, slow_client: SimulatorClient
) -> None:
    name = slow_client.start_sample(POSES[0])
    rendering(slow_client, name)
    limit = LIMITS["WatchOperation"]
    share = int(SHARE_OF_CONNECTION * limit)
    with own_channel(slow_server.address) as channel, own_channel(slow_server.address) as second:
        stubs = [simulator_pb2_grpc.SimulatorServiceStub(each) for each in (channel, second)]
        request = pb.WatchOperationRequest(name=name)
        watches = [
            stub.WatchOperation(request, timeout=PATIENCE_S)
            for stub, count in zip(stubs, (share, limit - share), strict=True)
            for _ in range(count)
        ]
        for watch in watches:
            assert next(watch).operation.name == name
        for _ in range(20):
            with pytest.raises(grpc.RpcError) as refused:
                next(stubs[0].WatchOperation(request, timeout=PATIENCE_S))
            assert isinstance(error_from_rpc(refused.value), QueueFullError)
        assert slow_client.is_ready(PATIENCE_S)
        assert slow_client.cancel_operation(name).state is State.CANCELLED
        for watch in watches:
            *_, last = watch
            assert last.operation.state == pb.OPERATION_STATE_CANCELLED
    assert ended(slow_client, name).state is State.CANCELLED


def test_connections_take_turns(slow_server: Server, slow_client: SimulatorClient) -> None:
    """Who asks for one sample waits for one of another's, not for all that were asked before."""
    with own_channel(slow_server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        many = [
            stub.StepSample(pb.StepSampleRequest(request_id=f"turn{i}")).operation.name
            for i in range(4)
        ]
        rendering(slow_client, many[0])
        mine = slow_client.start_sample(POSES[0])
        slow_client.cancel_operation(many[0])
        rendering(slow_client, mine)
        assert [slow_client.get_operation(name).state for name in many[1:]] == 3 * [State.QUEUED]


def test_a_cancelled_operation_frees_the_worker(slow_client: SimulatorClient) -> None:
    name = slow_client.start_sample(POSES[0])
    rendering(slow_client, name)
    assert slow_client.cancel_operation(name).state is State.CANCELLED
    status = ended(slow_client, name)
    assert isinstance(status.error, CancelledError)
    assert slow_client.query_height([[0, 0, 3]]).clearance_m == pytest.approx([3])


@pytest.mark.long
def test_a_sample_cancelled_as_it_ends_leaves_its_id_to_the_next_one(tmp_path: Path) -> None:
    env = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": "last-nap:0.5@2"}
    with Server(tmp_path / "naps", FLAT_WORLD, **env) as server, server.client() as client:
        client.step_batch()
        assert client.render_sample(POSES[0]).sample_id == 1
        name = client.start_sample(POSES[1])
        rendering(client, name)  # it is complete, and the worker is about to say so
        client.cancel_operation(name)
        status = ended(client, name)
        used = status.state is State.SUCCEEDED  # where this test was slower than the worker
        assert used or isinstance(status.error, CancelledError)
        following = client.render_sample(POSES[2])
        assert following.sample_id == (3 if used else 2)
        assert following.rig_pose == POSES[2]


def test_a_dropped_call_cancels_its_render(slow_client: SimulatorClient) -> None:
    class EnoughError(Exception):
        pass

    def leave(progress: Progress) -> None:
        if progress.stage == "fault":
            raise EnoughError

    with pytest.raises(EnoughError):
        slow_client.render_sample(POSES[0], on_progress=leave)
    assert slow_client.query_height([[0, 0, 3]]).clearance_m == pytest.approx([3])
    assert slow_client.info().sample_id == 0


@pytest.mark.parametrize("method", ["StepBatch", "StepSample"])
def test_a_call_that_is_dropped_before_its_answer_leaves_no_work(method: str) -> None:
    options = ServerOptions(worker_log_folder=None)
    supervisor = Supervisor(config_from_mapping(FLAT_WORLD), options, lambda _: None)
    operations = OperationQueue(supervisor)  # whose jobs nobody runs
    servicer = SimulatorServicer(supervisor, operations, lambda: None, shared_memory=False)
    contexts: list[grpc.ServicerContext] = []
    answer = getattr(servicer, method)

    def noting(request: Any, context: grpc.ServicerContext) -> Any:
        contexts.append(context)
        return answer(request, context)

    def others() -> list[Operation]:
        return [each for name, each in operations._known.items() if name != kept.name]

    setattr(servicer, method, noting)
    server = grpc.server(ThreadPoolExecutor(4))
    simulator_pb2_grpc.add_SimulatorServiceServicer_to_server(servicer, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    request = getattr(pb, f"{method}Request")()
    try:
        with own_channel(f"127.0.0.1:{port}") as channel:
            step = getattr(simulator_pb2_grpc.SimulatorServiceStub(channel), method)
            with operations._lock:
                dropped = step.future(request)
                wait_until(lambda: contexts)
                dropped.cancel()
                wait_until(lambda: not contexts[0].is_active())
            kept = step(request, timeout=PATIENCE_S).operation
            wait_until(lambda: all(each.status.state is State.CANCELLED for each in others()))
    finally:
        server.stop(None).wait()
    assert operations.get(kept.name).status.state is State.QUEUED


def test_a_sample_is_whole_for_its_caller_however_late_that_looks() -> None:
    """Its operation may end, and others fill the store, before the caller's thread goes on."""
    options = ServerOptions(worker_log_folder=None)
    supervisor = Supervisor(config_from_mapping(FLAT_WORLD), options, lambda _: None)
    operations = OperationQueue(supervisor)  # whose jobs nobody runs

    def end(operation: Operation, sample_id: int) -> None:
        whole = SampleMessages(
            pb.SampleHeader(batch_id=1, sample_id=sample_id), [], pb.SampleEnd(render_time_s=1.0)
        )
        assert operation.complete(whole, keep=operations.samples.add)

    job = Job(Kind.SAMPLE, "step", b"", PATIENCE_S, request_id="twice")
    with operations.follow(job) as operation:
        end(operation, 1)
        for sample_id in range(2, 2 + MAX_RECENT):
            end(operations.submit(Job(Kind.SAMPLE, "step", b"", PATIENCE_S)), sample_id)
        with pytest.raises(NotFoundError):
            operations.samples.get(1, 1)
        with operations.follow(job) as repeated:
            assert repeated is operation
        found = [each for each in operation.events(Event()) if isinstance(each, SampleMessages)]
        assert [(each.sample_id, each.end is not None) for each in found] == [(1, True)]
    assert not [each for each in operation.events(Event()) if isinstance(each, SampleMessages)]


def messages(sample_id: int, image_bytes: int) -> SampleMessages:
    frame = FrameMessage(pb.FrameHeader(), np.broadcast_to(np.uint8(0), (image_bytes, 1)))
    return SampleMessages(pb.SampleHeader(batch_id=1, sample_id=sample_id), [frame])


@pytest.mark.parametrize(("image_bytes", "kept"), [(1, MAX_RECENT), (MAX_BYTES // 4, 4)])
def test_what_was_just_sent_stays_for_its_reader_within_the_bound_of_bytes(
    image_bytes: int, kept: int
) -> None:
    """Of many views at once, some would be gone before their readers opened their memory."""
    store = SampleStore()
    for sample_id in range(100):
        store.add(messages(sample_id, image_bytes))
    assert [store.get(1, 99 - age).sample_id for age in range(kept)] == list(
        range(99, 99 - kept, -1)
    )
    with pytest.raises(NotFoundError):
        store.get(1, 99 - kept)


def test_a_view_waits_for_one_batch_of_each_other_connection() -> None:
    """Batches whose caller is gone are built, because it may know their names: in turns."""
    options = ServerOptions(worker_log_folder=None)
    supervisor = Supervisor(config_from_mapping(FLAT_WORLD), options, lambda _: None)
    operations = OperationQueue(supervisor)

    def submit(kind: Kind | None, peer: str) -> None:
        operations.submit(Job(kind, "step", b"", PATIENCE_S, peer=peer))

    def order() -> list[tuple[str, Kind | None]]:
        jobs = []
        while operations._waiting:
            operation = operations._next()
            assert operation is not None
            jobs.append((operation.job.peer, operation.job.kind))
        return jobs

    for _ in range(20):
        submit(Kind.BATCH, "gone")
    for kind in (Kind.SAMPLE, None, Kind.SAMPLE):
        submit(kind, "honest")
    built = ("gone", Kind.BATCH)
    assert order()[:6] == [
        *(built, ("honest", Kind.SAMPLE)),
        *(built, ("honest", None)),
        *(built, ("honest", Kind.SAMPLE)),
    ]

    # Of one connection, and for each connection's first batch, the order of requests holds.
    submit(Kind.BATCH, "a")
    submit(Kind.BATCH, "b")
    submit(Kind.BATCH, "a")
    submit(Kind.SAMPLE, "a")
    submit(Kind.SAMPLE, "c")
    peers = order()
    assert [peer for peer, kind in peers if kind is Kind.BATCH] == ["a", "b", "a"]
    assert peers.index(("c", Kind.SAMPLE)) == 2
    assert peers[-1] == ("a", Kind.SAMPLE)


def test_a_deadline_ends_the_call_and_the_work(
    slow_server: Server, slow_client: SimulatorClient
) -> None:
    worker = slow_server.worker().pid
    with (
        SimulatorClient(slow_server.address, timeout_s=0.5) as hasty,
        pytest.raises(DeadlineExceededError),
    ):
        hasty.render_sample(POSES[0])
    assert slow_client.query_height([[0, 0, 3]]).clearance_m == pytest.approx([3])
    assert slow_client.info().sample_id == 0
    assert slow_server.worker().pid == worker


def test_a_batch_overtakes_samples(slow_client: SimulatorClient) -> None:
    names = [slow_client.start_sample(pose) for pose in POSES[:3]]
    rendering(slow_client, names[0])
    with ThreadPoolExecutor() as pool:
        waiting = pool.submit(slow_client.render_sample, POSES[4])
        while slow_client.get_operation(names[0]).state is State.RUNNING:
            if _operations_known(slow_client, names[-1]):
                slow_client.step_batch()
        with pytest.raises(OvertakenError) as overtaken:
            waiting.result(PATIENCE_S)
    assert code_of(overtaken.value) == grpc.StatusCode.ABORTED
    for name in names:
        assert isinstance(ended(slow_client, name).error, OvertakenError)


def _operations_known(client: SimulatorClient, name: str) -> bool:
    """Whether an operation was enqueued after the one with this name."""
    instance, _, number = name.rpartition("-")
    try:
        client.get_operation(f"{instance}-{int(number) + 1}")
    except NotFoundError:
        return False
    return True


@pytest.mark.long
def test_requests_that_wait_are_bounded_in_bytes(slow_client: SimulatorClient) -> None:
    rendering(slow_client, slow_client.start_sample(POSES[0]))
    note = {"text": "x" * (MAX_METADATA_BYTES - 4096)}
    large = ModuleMetadata(custom={"note": note})
    names = [
        slow_client.start_sample(metadata=large) for _ in range(QUEUE_BYTES // MAX_METADATA_BYTES)
    ]
    assert len(names) < QUEUE_LIMIT
    with pytest.raises(QueueFullError, match="bytes of requests wait already") as refused:
        slow_client.start_sample(metadata=large)
    assert code_of(refused.value) == grpc.StatusCode.RESOURCE_EXHAUSTED
    slow_client.start_sample(POSES[1])  # a small one still has room
    slow_client.cancel_operation(names[3])
    slow_client.start_sample(metadata=large)


def test_a_full_queue_refuses_and_health_still_answers(slow_client: SimulatorClient) -> None:
    rendering(slow_client, slow_client.start_sample(POSES[0]))
    names = [slow_client.start_sample(POSES[1]) for _ in range(QUEUE_LIMIT)]
    with pytest.raises(QueueFullError) as refused:
        slow_client.start_sample(POSES[1])
    assert code_of(refused.value) == grpc.StatusCode.RESOURCE_EXHAUSTED
    assert slow_client.is_ready(PATIENCE_S)
    assert slow_client.info().batch_id > 0
    slow_client.cancel_operation(names[5])
    slow_client.start_sample(POSES[1])
