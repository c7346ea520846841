"""A server without gRPC's events of calls: it serves all the same, and ends calls publicly."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import grpc
import pytest
from attacks import code_and_details, own_channel
from waiting import wait_until

from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.private import rpc_event
from oaisys_grpc.server.limits import open_calls
from oaisys_grpc.server.limits.call_threads import CallThreads
from oaisys_grpc.server.limits.guarded_calls import GuardedCalls

MANY, FEW = 100, 3


@pytest.fixture
def address(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Of a server that waits a second for its readers, and answers with a message per MB asked."""
    monkeypatch.setattr(open_calls, "STALL_PATIENCE_S", 1.0)
    monkeypatch.setattr(rpc_event, "OF_CONTEXT", "gone")
    monkeypatch.setattr(rpc_event, "IN_ARGUMENT", "gone")

    def flood(count: int) -> Callable[..., Iterator[bytes]]:
        return lambda _request, _context: itertools.repeat(bytes(1 << 20), count)

    handlers = {
        name: grpc.unary_stream_rpc_method_handler(
            flood(count), pb.GetFrameRequest.FromString, bytes
        )
        for name, count in {"Many": MANY, "Few": FEW}.items()
    }
    calls = open_calls.OpenCalls()
    threads = CallThreads(8, lambda _: None)
    server = grpc.server(threads, interceptors=[GuardedCalls(calls)])  # type: ignore[arg-type]
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test", handlers),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()
    calls.close()


def test_without_events_calls_are_served_and_ended(
    address: str, fallback_lines: Callable[[], list[str]], caplog: pytest.LogCaptureFixture
) -> None:
    with own_channel(address, ("grpc.http2.bdp_probe", 0)) as channel:
        for _ in range(2):
            assert len(list(channel.unary_stream("/test/Few")(b""))) == FEW
        unread = channel.unary_stream("/test/Many")(b"")
        wait_until(lambda: "the answer was not read" in caplog.text)
        assert code_and_details(unread)[0] == grpc.StatusCode.CANCELLED
    argument, context = fallback_lines()
    assert "gRPC's event of a call cannot be used (no argument has gone)" in argument
    assert "gRPC's event of a call cannot be used (a context has no gone)" in context
