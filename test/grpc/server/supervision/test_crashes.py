"""A request that ends workers counts against itself and its client, not against everybody."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import grpc
import pytest
from attacks import OURS, own_channel
from served_simulator import ROCKY_WORLD, Server, code_of
from waiting import PATIENCE_S

from oaisys_core.errors import (
    BackendUnavailableError,
    DeadlineExceededError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata
from oaisys_grpc.contract.faults import DeadlyRequestError
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.server.supervision.crashes import (
    CLIENTS_ALLOWED,
    DEATHS_ALLOWED,
    Cause,
    Crashes,
    KilledWorkerError,
    OutgrownWorkerError,
)
from oaisys_grpc.server.supervision.worker_limits import CRASHES_ALLOWED, LONGEST_PAUSE_S
from oaisys_grpc.worker.fault_injection import CRASH_TEXT

CRASH = WorkerLostError("step_sample: the worker was ended by SIGSEGV")


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def crashes(clock: Clock) -> Crashes:
    return Crashes(clock)


def test_a_request_is_refused_after_two_deaths_whoever_sends_it(
    crashes: Crashes, clock: Clock
) -> None:
    for number in range(DEATHS_ALLOWED):
        assert crashes.refusal(Cause(f"client {number}", b"bomb")) is None
        crashes.note_crash(Cause(f"client {number}", b"bomb"), CRASH)
    refusal = crashes.refusal(Cause("another", b"bomb"))
    assert isinstance(refusal, DeadlyRequestError)
    assert "SIGSEGV" in str(refusal)
    assert crashes.refusal(Cause("another", b"view")) is None
    clock.now_s += LONGEST_PAUSE_S
    assert crashes.refusal(Cause("another", b"bomb")) is None
    crashes.note_crash(Cause("another", b"bomb"), CRASH)
    assert crashes.refusal(Cause("another", b"bomb")) is not None


def test_what_outgrows_memory_is_refused_at_once_and_what_others_killed_is_not(
    crashes: Crashes,
) -> None:
    crashes.note_crash(Cause("a", b"bomb"), OutgrownWorkerError("9000 MB"))
    assert isinstance(crashes.refusal(Cause("b", b"bomb")), DeadlyRequestError)
    for number in range(2 * DEATHS_ALLOWED):
        crashes.note_crash(Cause(f"c {number}", b"view"), KilledWorkerError("SIGKILL"))
        crashes.note_crash(Cause(f"d {number}", b"hang"), DeadlineExceededError("hung"))
    assert crashes.refusal(Cause("b", b"view")) is None
    assert crashes.refusal(Cause("b", b"hang")) is None


def test_a_client_that_loses_workers_is_refused_alone(crashes: Crashes, clock: Clock) -> None:
    crashes.note_success(Cause("honest", b"view"), rendered=True)
    for number in range(CRASHES_ALLOWED):
        assert not crashes.note_crash(Cause("hostile", b"bomb %d" % number), CRASH)
    refusal = crashes.refusal(Cause("hostile", b"another bomb"))
    assert isinstance(refusal, BackendUnavailableError)
    assert "of this connection" in str(refusal)
    assert crashes.refusal(Cause("honest", b"view")) is None
    clock.now_s += LONGEST_PAUSE_S
    assert crashes.refusal(Cause("hostile", b"view")) is None


def test_new_connections_are_one_client_once_anyone_had_success(crashes: Crashes) -> None:
    crashes.note_success(Cause("honest", b"view"), rendered=True)
    for number in range(10 * CLIENTS_ALLOWED):
        assert not crashes.note_crash(Cause(f"connection {number}", b"bomb %d" % number), CRASH)
        assert crashes.refusal(Cause("newcomer", b"view")) is None


@pytest.mark.parametrize("had_success", [False, True])
def test_many_clients_that_fail_and_none_that_succeeds_mean_a_faulty_worker(
    crashes: Crashes, clock: Clock, had_success: bool
) -> None:
    clients = [f"client {number}" for number in range(CLIENTS_ALLOWED + 1)]
    if had_success:
        for name in clients:
            crashes.note_success(Cause(name, b"view"), rendered=True)
    causes = [Cause(name, name.encode()) for name in clients]
    assert not any(crashes.note_crash(cause, CRASH) for cause in causes[:-1])
    assert crashes.note_crash(causes[-1], CRASH)
    crashes.note_success(causes[0], rendered=True)
    assert not crashes.note_crash(causes[-1], CRASH)


def test_memory_of_crashes_is_bounded(crashes: Crashes) -> None:
    for number in range(5000):
        crashes.note_crash(Cause(f"client {number}", b"%d" % number), CRASH)
        crashes.note_success(Cause(f"other {number}", b"x%d" % number), rendered=True)
    kept: list[Any] = [crashes._requests, crashes._clients, crashes._known]
    assert max(map(len, kept)) <= 1024


@pytest.mark.long
def test_bombs_of_one_client_do_not_stop_the_others(start_server: Callable[..., Server]) -> None:
    """The same one, other ones, and other ones by new connections."""
    server = start_server(ROCKY_WORLD, OAISYS_TEST_BUILD="1", OAISYS_FAULT="crash-asked")

    def bomb(number: int) -> bytes:
        request = pb.RenderSampleRequest(request_id=f"bomb {number} {id(object())}")
        request.metadata.custom.update({"please": f"{CRASH_TEXT.decode()} {number}"})
        return request.SerializeToString()

    def code_of_bomb(channel: grpc.Channel, number: int) -> grpc.StatusCode:
        render: Any = channel.unary_stream(OURS + "RenderSample")
        call = render(bomb(number), timeout=PATIENCE_S)
        with pytest.raises(grpc.RpcError):
            list(call)
        code: grpc.StatusCode = call.code()
        return code

    lost, refused = grpc.StatusCode.ABORTED, grpc.StatusCode.FAILED_PRECONDITION
    with server.client() as honest, own_channel(server.address) as hostile:
        honest.step_batch()
        assert [code_of_bomb(hostile, 0) for _ in range(4)] == [lost, lost, refused, refused]
        assert honest.render_sample(pose_looking_down(0, 0, 9)).sample_id == 1
        assert [code_of_bomb(hostile, number) for number in (1, 2)] == [lost, refused]
        for number in range(3, 5):
            with own_channel(server.address) as other:
                assert code_of_bomb(other, 0) is refused
                assert code_of_bomb(other, number) is lost
        honest.wait_ready(PATIENCE_S)
        assert honest.render_sample(pose_looking_down(0, 0, 9)).sample_id == 2
        with pytest.raises(OaisysError) as told:  # the same from an honest client
            honest.render_sample(metadata=ModuleMetadata(custom={"please": "crash, please 0"}))
        assert code_of(told.value) in (lost, refused)
    assert "Traceback" not in server.stderr.read_text()
