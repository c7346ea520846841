"""Far too many calls and connections: the others are served, and nothing stays."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import psutil
import pytest
from attacks import OURS
from raw_http2 import RawConnection
from served_simulator import FLAT_WORLD, Server
from waiting import LOAD_FACTOR, PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_core.system.periodic_count import PERIOD_S
from oaisys_grpc.server.limits import call_threads as threads_module
from oaisys_grpc.server.limits.call_threads import MAX_WITHOUT_REQUEST, CallThreads
from oaisys_grpc.server.limits.connections import STREAMS_OF_CONNECTION
from oaisys_grpc.server.limits.ended_calls import EndedCalls
from oaisys_grpc.server.limits.slots import MAX_WAITING

VIEW_S = 2.0
"""For a view while others attack; it takes 0.05 s otherwise."""

KEPT_MB = 100
"""Of memory, by gRPC's and the C library's heaps, after an attack."""

SPARE_THREADS = 30
CONNECTIONS, TOTAL = 34, 17_000


class Event:
    """A call as gRPC's server hands it over."""

    call_details = None

    def __init__(self, peer: str) -> None:
        self.call = self
        self._peer = peer
        self.ended = b""

    def peer(self) -> str:
        return self._peer

    def cancel(self, _code: int, details: bytes) -> None:
        self.ended = details


@pytest.mark.parametrize(
    "connections",
    [
        pytest.param(1, marks=pytest.mark.long),
        pytest.param(CONNECTIONS, marks=pytest.mark.soak),
    ],
)
def test_calls_without_a_request_keep_nobody_waiting_and_leave_nothing(
    start_server: Callable[..., Server], connections: int
) -> None:
    server = start_server(FLAT_WORLD)
    process = psutil.Process(server.process.pid)
    with server.client() as client:
        client.step_batch()
        client.render_sample(pose_looking_down(0, 0, 5))
        threads, megabytes = process.num_threads(), process.memory_info().rss / 1e6
        with ExitStack() as stack:
            attackers = [
                stack.enter_context(RawConnection(server.address)) for _ in range(connections)
            ]
            peak = 0
            for _ in range(2):
                for attacker in attackers:
                    attacker.begin_calls(OURS + "RenderSample", TOTAL // connections)
                for number in range(3):
                    begin_s = time.monotonic()
                    client.render_sample(pose_looking_down(0.01 * number, 0, 5))
                    client.info()
                    assert time.monotonic() - begin_s < LOAD_FACTOR * VIEW_S
                    peak = max(peak, process.num_threads())
            wait_until(server.stderr.read_text)
            assert peak <= threads + MAX_WITHOUT_REQUEST + MAX_WAITING + SPARE_THREADS
            if connections == 1:
                assert peak <= threads + STREAMS_OF_CONNECTION + SPARE_THREADS
        wait_until(lambda: process.num_threads() <= threads + SPARE_THREADS)
        wait_until(lambda: process.memory_info().rss / 1e6 < megabytes + KEPT_MB)
        assert client.render_sample(pose_looking_down(0, 0, 5)).frames
    told = server.stderr.read_text().splitlines()
    assert len(told) < 10, told
    assert "Traceback" not in "".join(told)


def test_a_call_of_another_connection_is_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads_module, "MAX_QUEUED", 20)
    refused: list[str] = []
    threads = CallThreads(2, refused.append, idle_s=0.05)
    go, order = threading.Event(), []
    crowd = [Event("crowd") for _ in range(40)]

    def run(_event: Event, name: str) -> None:
        go.wait(PATIENCE_S)
        order.append(name)

    futures = [threads.submit(run, event, "crowd") for event in crowd]
    futures.append(threads.submit(run, Event("other"), "other"))
    go.set()
    wait_until(lambda: all(future.done() for future in futures))
    assert order.index("other") <= 2
    assert set(refused) == {"crowd"}
    assert [bool(event.ended) for event in crowd].count(True) == len(refused) > 0
    wait_until(lambda: threads._threads == 0)
    threads.shutdown()


def test_calls_without_requests_do_not_take_all_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads_module, "MAX_WITHOUT_REQUEST", 2)
    threads = CallThreads(8, lambda _: None)
    go, begun = threading.Event(), []

    def run(event: Event, has_request: Any) -> None:
        begun.append(event.peer())
        if has_request:
            threads.request_came()
        go.wait(PATIENCE_S)

    for _ in range(3):
        threads.submit(run, Event("honest"), True)
    wait_until(lambda: len(begun) == 3)
    for _ in range(5):
        threads.submit(run, Event("crowd"), False)
    wait_until(lambda: len(begun) == 5)
    time.sleep(0.1)
    assert begun.count("crowd") == 2
    go.set()
    wait_until(lambda: len(begun) == 8)
    threads.shutdown()


def test_ended_calls_are_one_line_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 1000.0
    ended = EndedCalls(lambda: now_s)
    with caplog.at_level(logging.WARNING):
        for number in range(18_000):
            ended.add(f"Check of {number}", "not read")
        assert caplog.messages == ["Check of 0: not read"]
        now_s += PERIOD_S
        ended.tell()
        ended.add("Watch of 7", "not read")
        assert caplog.messages[1:] == ["17999 calls, at last Check of 17999: not read"]
        ended.tell(at_once=True)
        assert caplog.messages[2:] == ["Watch of 7: not read"]
