"""One client cannot hurt the others: memory, threads, places and the end of the server."""

from __future__ import annotations

import functools
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import psutil
import pytest
from attacks import (
    OURS,
    code_and_details,
    deep_structs,
    entry,
    in_metadata,
    list_of_structs,
    mapping_of_structs,
    nested,
    never,
    own_channel,
)
from grpc_health.v1 import health_pb2, health_pb2_grpc
from served_simulator import FLAT_WORLD, ROCKY_WORLD, Server
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import ModuleMetadata
from oaisys_grpc.contract.metadata import metadata_to_proto
from oaisys_grpc.contract.request_bounds import MAX_FIELDS, check_bounds
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.server.limits import open_calls
from oaisys_grpc.server.limits.guarded_calls import GuardedCalls
from oaisys_grpc.server.limits.open_calls import (
    CROWDED_PATIENCE_S,
    REQUEST_PATIENCE_S,
)
from oaisys_grpc.server.limits.slots import LIMITS, SHARE_OF_CONNECTION

StartServer = Callable[..., Server]

LOAD = 4.0
"""Factor on promised seconds for a machine that does other things beside."""

REFUSALS, REFUSAL_S, KEPT_MB = 99, 1.0, 50
REQUEST_BYTES = 4 * 1024 * 1024 - 1024
END_S = 5.0
STREAMS = 60
HEALTH = "/grpc.health.v1.Health/"
REFLECTION = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo"
UNREAD = "the answer was not read"
"""Others need the room; or, where views come slowly, nobody read it for its 30 s."""
ONE_ANSWER = [
    HEALTH + "Check",
    OURS + "StepBatch",
    OURS + "QueryHeight",
    "/oaisys.Oaisys/StepBatch",
]
STREAMED = [HEALTH + "Watch", OURS + "WatchOperation", OURS + "RenderSample", OURS + "GetSample"]


@functools.cache
def content_of(shape: Callable[[int], bytes]) -> bytes:
    """Return a request of a shape that is as large as a request may be."""
    return shape(REQUEST_BYTES)


def megabytes(process: int) -> float:
    return float(psutil.Process(process).memory_info().rss / 1e6)


@pytest.mark.parametrize("part", ["asset", "environment", "render", "custom"])
@pytest.mark.parametrize("shape", [list_of_structs, mapping_of_structs, deep_structs])
def test_too_much_is_refused_before_it_is_read(shape: Callable[[int], bytes], part: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        check_bounds(in_metadata(part, content_of(shape)), pb.StepBatchRequest.DESCRIPTOR)
    assert refused.value.field == "request"


def test_what_a_user_sends_is_within_bounds() -> None:
    request = pb.StepBatchRequest(request_id="a")
    thing: Any = {
        "shape": "box",
        "size_m": [1, 1, 1],
        "position_m": [1.5, 2.5, 0],
        "label": "thing",
    }
    request.metadata.asset.update({"add": {f"thing_{i}": thing for i in range(2000)}})
    check_bounds(request.SerializeToString(), request.DESCRIPTOR)
    request.metadata.asset.update({"more": [0.5] * MAX_FIELDS})
    with pytest.raises(InvalidInputError, match=str(MAX_FIELDS)):
        check_bounds(request.SerializeToString(), request.DESCRIPTOR)


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\xff\xff",
        b"\xff" * 64,
        nested(2, b"\xff\xff\xff"),  # in the metadata
        nested(2, nested(4, b"\x0b")),  # a group that begins
        b"\x12\x7f",  # metadata longer than what came
        b"\x00\x00",  # field 0
        in_metadata("custom", entry(b"a", b"\xff")),
    ],
)
def test_bytes_that_are_no_message(data: bytes) -> None:
    with pytest.raises(InvalidInputError):
        check_bounds(data, pb.StepBatchRequest.DESCRIPTOR)


def test_a_call_without_fields_takes_no_bytes_that_are_no_message() -> None:
    """Protobuf itself lets these pass, and the call may be EndSimulation."""
    with pytest.raises(InvalidInputError):
        check_bounds(b"\x00\x01", pb.EndSimulationRequest.DESCRIPTOR)
    check_bounds(b"", pb.EndSimulationRequest.DESCRIPTOR)


@pytest.mark.long
def test_refused_requests_leave_no_memory_behind(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    shapes = (list_of_structs, mapping_of_structs, deep_structs)
    requests = [
        in_metadata(part, content_of(shape))
        for part in ("asset", "custom", "render")
        for shape in shapes
    ]
    with server.client() as client, own_channel(server.address) as channel:
        client.step_batch()
        worker = server.worker().pid
        before = [megabytes(pid) for pid in (server.process.pid, worker)]
        step: Any = channel.unary_unary(OURS + "StepBatch")
        slowest_s = 0.0
        for number in range(REFUSALS):
            begin_s = time.monotonic()
            with pytest.raises(grpc.RpcError) as refused:
                step(requests[number % len(requests)], timeout=PATIENCE_S)
            slowest_s = max(slowest_s, time.monotonic() - begin_s)
            assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
        assert slowest_s < LOAD * REFUSAL_S
        for pid, first in zip((server.process.pid, worker), before, strict=True):
            wait_until(lambda: megabytes(pid) < first + KEPT_MB, LOAD * 5)  # noqa: B023
        assert client.render_sample(pose_looking_down(0, 0, 5)).sample_id == 1


@pytest.mark.long
def test_requests_that_failed_are_not_kept(start_server: StartServer) -> None:
    """Each is within the bounds, but the worker refuses it: only a digest of it stays."""
    server = start_server(FLAT_WORLD)
    with server.client() as client, own_channel(server.address) as channel:
        client.step_batch()
        step: Any = channel.unary_unary(OURS + "StepBatch")
        text = b"x" * (REQUEST_BYTES - 100)

        def fail(numbers: range) -> None:
            for number in numbers:
                request = in_metadata("asset", entry(b"no such key", nested(3, text)))
                answer = step(request + nested(1, b"id%d" % number), timeout=PATIENCE_S)
                name = pb.StepBatchResponse.FromString(answer).operation.name
                *_, last = client.watch_operation(name)
                assert isinstance(last.error, InvalidInputError)

        fail(range(10))  # gRPC's buffers of a connection grow with its first large messages
        before = megabytes(server.process.pid)
        fail(range(10, 35))
        wait_until(lambda: megabytes(server.process.pid) < before + KEPT_MB, LOAD * 5)


def test_bad_bytes_to_any_service_are_refused_and_the_end_comes(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    bad = b"\xff\xff\xff"
    with own_channel(server.address) as channel:
        for _ in range(3):
            for path in ONE_ANSWER:
                with pytest.raises(grpc.RpcError) as refused:
                    channel.unary_unary(path)(bad, timeout=PATIENCE_S)
                assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT, path
            for path in STREAMED:
                code, _ = code_and_details(channel.unary_stream(path)(bad, timeout=PATIENCE_S))
                assert code == grpc.StatusCode.INVALID_ARGUMENT, path
            talk = channel.stream_stream(REFLECTION)(iter([bad] * 3), timeout=PATIENCE_S)
            assert code_and_details(talk)[0] == grpc.StatusCode.INVALID_ARGUMENT
        assert_ends(server)


@pytest.mark.long
def test_a_second_signal_after_bad_bytes_to_reflection_ends_the_server(
    start_server: StartServer,
) -> None:
    server = start_server(FLAT_WORLD)
    bad = [b"\xff\xff\xff"] * 3
    with own_channel(server.address) as channel:
        for _ in range(3):
            talk = channel.stream_stream(REFLECTION)(iter(bad), timeout=PATIENCE_S)
            assert code_and_details(talk)[0] == grpc.StatusCode.INVALID_ARGUMENT
        assert_ends(server, signals=2)


def assert_ends(server: Server, signals: int = 1) -> None:
    begin_s = time.monotonic()
    for number in range(signals):
        if number:
            time.sleep(0.1)
        server.process.terminate()
    assert server.process.wait(PATIENCE_S) == 0
    assert time.monotonic() - begin_s < END_S + LOAD
    assert "Traceback" not in server.stderr.read_text()


@pytest.mark.parametrize(
    "connections",
    [
        pytest.param(1, marks=pytest.mark.soak),
        pytest.param(STREAMS, marks=pytest.mark.long),
    ],
)
def test_streams_that_nobody_reads_hold_up_nobody(
    start_server: StartServer, connections: int
) -> None:
    camera = {"width_px": 1024, "height_px": 768, "fx_px": 866.0, "fy_px": 866.0}
    server = start_server({**ROCKY_WORLD, "sensors": {"cameras": [camera]}})
    with server.client() as client:
        client.step_batch()
    channels = [own_channel(server.address) for _ in range(connections)]
    unread: list[Any] = [None] * STREAMS
    ended: list[Any] = []
    stopped = threading.Event()

    def hold() -> None:
        while not stopped.is_set():
            for index, call in enumerate(unread):
                if call is None or call.done():
                    ended.append(call)
                    channel = channels[index % connections]
                    unread[index] = channel.unary_stream(OURS + "RenderSample")(b"")
            stopped.wait(0.2)

    attack = threading.Thread(target=hold)
    attack.start()
    try:
        with server.client() as client:
            for number in range(5):
                sample = client.render_sample(pose_looking_down(0.01 * number, 0, 8))
                assert sample.frames
                assert client.is_ready(LOAD)
                client.info()
        wait_until(lambda: UNREAD in server.stderr.read_text())
    finally:
        stopped.set()
        attack.join()
    ends = [code_and_details(call) for call in (*ended, *unread) if call is not None]
    assert [
        code
        for code, details in ends
        if code == grpc.StatusCode.RESOURCE_EXHAUSTED and details.startswith(UNREAD)
    ]
    for channel in channels:
        channel.close()
    assert_ends(server)


EXTREMES: list[dict[str, Any]] = [
    {"fx_px": 1e-300, "cx_px": 1e308},
    {"fx_px": 5e-324, "fy_px": 5e-324},
    {"fx_px": 1.7e308},
    {"cx_px": -1.7e308, "cy_px": 1e300},
    {"distortion": {"k1": 1e300}},
    {"lens": {"focus_distance_m": 1e-300}},
    {"fx_px": 0.64, "fy_px": 64000.0, "cx_px": 6400.0},  # as far as the bounds go
    {"fx_px": 0.64, "fy_px": 0.64, "cx_px": -6400.0, "cy_px": 6400.0},
]


@pytest.mark.long
def test_cameras_at_the_edge_of_floats_keep_nobody_waiting(start_server: StartServer) -> None:
    """Typed and open-ended; in a world of a hundred times the rocks."""
    server = start_server(ROCKY_WORLD)
    waits_s: list[float] = []
    codes = set()
    with server.client() as client, own_channel(server.address) as channel:
        client.step_batch(metadata=ModuleMetadata(asset={"count_factor": 100.0}))
        client.query_height([[0, 0, 5]])
        worker = server.worker().pid
        step: Any = channel.unary_stream(OURS + "RenderSample")
        for extreme in EXTREMES:
            typed = metadata_to_proto(ModuleMetadata(sensor={"cameras": {"camera": extreme}}))
            loose = pb.ModuleMetadata()
            loose.sensor.settings.update({"cameras": {"camera": extreme}})
            for metadata in (typed, loose):
                request = pb.RenderSampleRequest(metadata=metadata)
                call = step(request.SerializeToString(), timeout=LOAD * END_S)
                begin_s = time.monotonic()
                client.query_height([[0, 0, 5]])
                waits_s.append(time.monotonic() - begin_s)
                codes.add(code_and_details(call)[0])
        assert server.worker().pid == worker
    assert codes == {grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.OK}
    assert max(waits_s) < LOAD * END_S


@pytest.fixture
def hasty_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of a server in this process that waits for its readers for a second only."""
    monkeypatch.setattr(open_calls, "STALL_PATIENCE_S", 1.0)

    def flood(_request: bytes, _context: grpc.ServicerContext) -> Iterator[bytes]:
        yield from itertools.repeat(bytes(1 << 20), 100)

    read, write = pb.GetFrameRequest.FromString, bytes
    handlers = {"Flood": grpc.unary_stream_rpc_method_handler(flood, read, write)}
    calls = open_calls.OpenCalls()
    server = grpc.server(ThreadPoolExecutor(8), interceptors=[GuardedCalls(calls)])
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test", handlers),))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()
    calls.close()


def test_a_reader_that_reads_nothing_is_told_why_it_was_ended(
    hasty_server: str, caplog: pytest.LogCaptureFixture
) -> None:
    # Otherwise gRPC's window grows with the connection's speed, and may take the whole answer.
    with own_channel(hasty_server, ("grpc.http2.bdp_probe", 0)) as channel:
        unread, read = (channel.unary_stream("/test/Flood")(b"") for _ in range(2))
        assert code_and_details(read)[0] == grpc.StatusCode.OK
        wait_until(lambda: "the answer was not read" in caplog.text)
        assert code_and_details(unread) == (
            grpc.StatusCode.RESOURCE_EXHAUSTED,
            "the answer was not read for 1 s",
        )


@pytest.mark.long
def test_idle_watches_of_health_make_room(start_server: StartServer) -> None:
    """For another connection: the oldest of the one that has most of them."""
    server = start_server(FLAT_WORLD)
    most = LIMITS["Watch"]
    share = int(SHARE_OF_CONNECTION * most)

    def watch(channel: grpc.Channel) -> Any:
        start: Any = channel.unary_stream(HEALTH + "Watch")
        call = start(b"", timeout=PATIENCE_S)
        answer = health_pb2.HealthCheckResponse.FromString(next(call))
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
        return call

    greedy, modest, other = (own_channel(server.address) for _ in range(3))
    with greedy, modest, other:
        idle = [watch(greedy) for _ in range(share)]
        kept = [watch(modest) for _ in range(most - share)]
        time.sleep(2 * CROWDED_PATIENCE_S)
        for ended in idle[:3]:
            begin_s = time.monotonic()
            kept.append(watch(other))
            assert time.monotonic() - begin_s < LOAD
            assert code_and_details(ended)[0] == grpc.StatusCode.RESOURCE_EXHAUSTED
        assert not any(call.done() for call in kept)
        time.sleep(2 * CROWDED_PATIENCE_S)
        watch(greedy)
        assert not any(call.done() for call in kept)
        assert_ends(server)


@pytest.mark.long
def test_requests_that_never_come_leave_room_for_others(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    paths = [HEALTH + "Check", HEALTH + "Watch", OURS + "GetSimulatorInfo", REFLECTION]
    channels = [own_channel(server.address) for _ in range(10)]
    ended = threading.Event()
    # On the wire, calls of all kinds begin alike.
    begun = [
        channels[i % 10].stream_stream(paths[i % len(paths)])(never(ended)) for i in range(600)
    ]
    try:
        with own_channel(server.address) as channel, server.client() as client:
            health = health_pb2_grpc.HealthStub(channel)
            for _ in range(5):
                begin_s = time.monotonic()
                health.Check(health_pb2.HealthCheckRequest(), timeout=PATIENCE_S)
                client.info()
                assert time.monotonic() - begin_s < 2 * LOAD
            wait_until(lambda: all(call.done() for call in begun), LOAD * REQUEST_PATIENCE_S)
            codes = {call.code() for call in begun}
            assert codes == {grpc.StatusCode.RESOURCE_EXHAUSTED}
        assert_ends(server)
    finally:
        ended.set()
        for each in channels:
            each.close()
