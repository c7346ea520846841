"""What gRPC says of a client's metadata: one line a minute, whatever the client sends."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from raw_http2 import RawConnection
from served_simulator import FLAT_WORLD, Server

from oaisys_core.system.periodic_count import PERIOD_S
from oaisys_grpc.server.limits.grpc_log import GrpcLogLimit

CALLS = 90
CHECK = "/grpc.health.v1.Health/Check"
BINARY = ("a", b"\x81\x02b")
LOG = logging.getLogger("grpc._cython.cygrpc")


def test_it_tells_of_the_first_at_once_and_of_others_by_number(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock_s = 0.0
    limit = GrpcLogLimit(lambda: clock_s)
    limit.begin()
    for _ in range(5):
        LOG.error("Invalid encoding on %s", b"\x81" * 1000, exc_info=ValueError("no"))
    clock_s = PERIOD_S
    LOG.error("Invalid encoding on %s", b"\x82")
    LOG.error("Invalid encoding on %s", b"\x83")
    limit.end()
    LOG.error("as it is")

    first, others, rest, free = caplog.records
    assert first.getMessage().startswith("Invalid encoding on b'")
    assert len(first.getMessage()) <= 200
    assert first.exc_info is None
    assert others.getMessage() == "5 times, at last: Invalid encoding on b'\\x82'"
    assert rest.getMessage() == "Invalid encoding on b'\\x83'"
    assert free.getMessage() == "as it is"


def test_metadata_that_is_no_text_fills_no_log(start_server: Callable[..., Server]) -> None:
    server = start_server(FLAT_WORLD)
    with RawConnection(server.address) as connection:
        begun = connection.begin_calls(CHECK, CALLS, BINARY)
    assert begun == CALLS
    with grpc.insecure_channel(server.address) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        assert stub.Check(health_pb2.HealthCheckRequest(), timeout=30).status
    server.end()
    said = server.stderr.read_text()
    assert "Traceback" not in said
    counts = [int(n or 1) for n in re.findall(r"(?:(\d+) times, at last: )?Invalid encoding", said)]
    assert 1 <= len(counts) <= 3
    assert sum(counts) >= CALLS
