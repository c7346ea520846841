"""A crash loop ends with a pause, and pauses end with another worker."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import grpc
import pytest
from attacks import OURS, own_channel
from served_simulator import ROCKY_WORLD, Server, code_of
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import BackendUnavailableError, OaisysError, WorkerLostError
from oaisys_core.geometry import pose_looking_down
from oaisys_grpc.contract.errors import REASON_KEY
from oaisys_grpc.server.supervision.worker_limits import (
    CRASH_WINDOW_S,
    CRASHES_ALLOWED,
    FIRST_PAUSE_S,
    LONGEST_PAUSE_S,
    Breaker,
)

CRASH = WorkerLostError("the worker was ended by SIGSEGV")
LOAD_S = 20.0
"""On top of a pause, for a worker to start on a machine that does other things beside."""


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def breaker(clock: Clock) -> Breaker:
    """One that has just opened."""
    breaker = Breaker(clock)
    for _ in range(CRASHES_ALLOWED):
        assert breaker.refusal is None
        breaker.note_crash(CRASH)
    return breaker


def pause_s(breaker: Breaker, clock: Clock) -> float:
    """Wait until a worker may be started, and return how long that took."""
    begin_s = clock.now_s
    while (refusal := breaker.refusal) is not None:
        assert isinstance(refusal, BackendUnavailableError)
        assert "SIGSEGV" in str(refusal)
        clock.now_s += 1.0
    return clock.now_s - begin_s


def test_pauses_grow_until_a_worker_has_worked(breaker: Breaker, clock: Clock) -> None:
    assert "another one is started in 10 s" in str(breaker.refusal)
    pauses_s = []
    for _ in range(9):
        pauses_s.append(pause_s(breaker, clock))
        breaker.note_crash(CRASH)
    doubled = [min(FIRST_PAUSE_S * 2**n, LONGEST_PAUSE_S) for n in range(9)]
    assert pauses_s == doubled
    pause_s(breaker, clock)
    breaker.note_success()
    for _ in range(CRASHES_ALLOWED):
        assert breaker.refusal is None
        breaker.note_crash(CRASH)
    assert pause_s(breaker, clock) == FIRST_PAUSE_S


def test_a_worker_that_lived_long_enough_counts_as_one_that_worked(
    breaker: Breaker, clock: Clock
) -> None:
    pause_s(breaker, clock)
    clock.now_s += CRASH_WINDOW_S + 1
    breaker.note_crash(CRASH)
    assert breaker.refusal is None


def test_crashes_far_apart_are_no_loop(clock: Clock) -> None:
    breaker = Breaker(clock)
    for _ in range(10):
        breaker.note_crash(CRASH)
        assert breaker.refusal is None
        clock.now_s += CRASH_WINDOW_S / (CRASHES_ALLOWED - 1)


def reason_of(call: Any) -> str:
    """Return why no worker runs, as a call that was answered tells it."""
    told: dict[str, str] = {item.key: item.value for item in call.trailing_metadata()}
    return told.get(REASON_KEY, "")


@pytest.mark.long
def test_after_a_crash_loop_the_server_tries_again_and_health_says_when(
    start_server: Callable[..., Server],
) -> None:
    server = start_server(ROCKY_WORLD)
    with server.client() as client, own_channel(server.address) as channel:
        client.step_batch(seed=5)
        before = client.render_sample(pose_looking_down(0, 0, 9))
        for _ in range(CRASHES_ALLOWED):
            worker = server.worker()
            worker.kill()
            wait_until(lambda: not worker.is_running())  # noqa: B023
            wait_until(lambda: not client.is_ready(PATIENCE_S) or server.worker() != worker)  # noqa: B023
        wait_until(lambda: not client.is_ready(PATIENCE_S))
        opened_s = time.monotonic()
        check: Any = channel.unary_unary("/grpc.health.v1.Health/Check")
        _, call = check.with_call(b"", timeout=PATIENCE_S)
        _, info = channel.unary_unary(OURS + "GetSimulatorInfo").with_call(b"", timeout=PATIENCE_S)
        for told in (reason_of(call), reason_of(info)):
            assert "SIGKILL" in told
            assert "another one is started in " in told
        with pytest.raises(OaisysError, match="another one is started in ") as refused:
            client.render_sample()
        assert code_of(refused.value) is grpc.StatusCode.FAILED_PRECONDITION
        client.wait_ready(PATIENCE_S)
        waited_s = time.monotonic() - opened_s
        assert FIRST_PAUSE_S / 2 < waited_s < FIRST_PAUSE_S + LOAD_S
        after = client.render_sample()
        assert after.sample_id == before.sample_id + 1
        depth = [s.frame("camera", "depth").data.tobytes() for s in (before, after)]
        assert depth[0] == depth[1]
        _, call = check.with_call(b"", timeout=PATIENCE_S)
        assert not reason_of(call)
