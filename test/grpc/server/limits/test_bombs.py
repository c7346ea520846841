"""What is small on the wire and large in memory, and many small things: all are bounded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import grpc
import psutil
import pytest
from attacks import OURS, code_and_details, own_channel
from grpc_reflection.v1alpha import reflection_pb2
from served_simulator import Server
from waiting import PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_grpc.client.simulator_client import SimulatorClient

BOMB_BYTES, KEPT_MB = 64 << 20, 50
"""Sixteen times what a request may have; less than half of what some of them would take."""

REFLECTION = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo"
PATHS = [
    "/grpc.health.v1.Health/Check",
    "/grpc.health.v1.Health/Watch",
    "/oaisys.Oaisys/StepBatch",
    REFLECTION,
    *(OURS + name for name in ("StepBatch", "RenderSample", "GetSample", "QueryHeight")),
]


def megabytes(server: Server) -> float:
    return float(psutil.Process(server.process.pid).memory_info().rss / 1e6)


def call(channel: grpc.Channel, path: str, messages: Iterator[bytes], **options: Any) -> Any:
    """On the wire, calls of all kinds begin alike."""
    start: Any = channel.stream_stream(path)
    return start(messages, timeout=PATIENCE_S, **options)


@pytest.mark.long
def test_compressed_bombs_are_refused_before_they_unfold(
    flat_server: Server, flat_client: SimulatorClient
) -> None:
    with own_channel(flat_server.address, ("grpc.max_send_message_length", -1)) as channel:
        before = megabytes(flat_server)
        calls = [
            call(channel, path, iter([bytes(BOMB_BYTES)]), compression=grpc.Compression.Gzip)
            for path in PATHS
        ]
        assert {code_and_details(each)[0] for each in calls} == {grpc.StatusCode.RESOURCE_EXHAUSTED}
        assert megabytes(flat_server) < before + KEPT_MB
    assert flat_client.render_sample(pose_looking_down(0, 0, 5)).frames


@pytest.mark.parametrize("headers", [[("large", "x" * (1 << 20))], [("a", "b" * 900)] * 900])
def test_huge_headers_are_refused(
    flat_server: Server, flat_client: SimulatorClient, headers: list[tuple[str, str]]
) -> None:
    with own_channel(flat_server.address) as channel:
        before = megabytes(flat_server)
        for path in PATHS:
            answer = call(channel, path, iter([b""]), metadata=headers)
            assert code_and_details(answer)[0] is not grpc.StatusCode.OK
        assert megabytes(flat_server) < before + KEPT_MB
    assert flat_client.render_sample(pose_looking_down(0, 0, 5)).frames


def test_a_million_tiny_messages_hold_up_nobody(
    flat_server: Server, flat_client: SimulatorClient
) -> None:
    """Where one message is expected, no other is read; reflection answers one after the other."""
    tiny = reflection_pb2.ServerReflectionRequest(list_services="").SerializeToString()
    sent = dict.fromkeys(PATHS, 0)

    def messages(path: str) -> Iterator[bytes]:
        for _ in range(1_000_000):
            sent[path] += 1
            yield tiny if path == REFLECTION else b""

    with own_channel(flat_server.address) as channel:
        before = megabytes(flat_server)
        calls = [call(channel, path, messages(path)) for path in PATHS if "Step" not in path]
        wait_until(lambda: sent[REFLECTION] > 1000)
        assert flat_client.render_sample(pose_looking_down(0, 0, 5)).frames
        assert megabytes(flat_server) < before + KEPT_MB
        for each in calls:
            each.cancel()
    assert flat_client.is_ready(PATIENCE_S)
