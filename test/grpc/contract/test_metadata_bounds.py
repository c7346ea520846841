"""Metadata that no server would take are refused where they are made, by the name of their key."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.client.channel import batch_request, render_request, translate_errors
from oaisys_grpc.contract.metadata import metadata_from_proto, metadata_to_proto, struct_to_proto
from oaisys_grpc.contract.request_bounds import MAX_REQUEST_BYTES, check_bounds
from oaisys_grpc.contract.transfer import DEFAULT_TRANSFER

MODULES = ("sensor", "environment", "asset", "render", "custom")
MOST_DEEP = 20
"""The server takes 64 messages in each other: request, metadata, sensors; three for each object."""

POSE = Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
NAMES = [f"a_name_of_a_sensor_{index}" for index in range(1000)]


def objects(depth: int) -> dict[str, Any]:
    """Return objects in each other; the outermost counts."""
    value: Any = 1
    for _ in range(depth):
        value = {"a": value}
    return dict(value)


def lists(depth: int) -> dict[str, Any]:
    """Return an object of lists in each other; the object counts."""
    value: Any = 1
    for _ in range(depth - 1):
        value = [value]
    return {"a": value}


def check_as_server(metadata: ModuleMetadata, names: list[str]) -> None:
    for request in (
        render_request(POSE, metadata, names, names, DEFAULT_TRANSFER),
        batch_request(1.0, 1, False, metadata, "x" * 256),
    ):
        data = request.SerializeToString()
        assert len(data) <= MAX_REQUEST_BYTES
        check_bounds(data, request.DESCRIPTOR)


@pytest.mark.parametrize("module", MODULES)
@pytest.mark.parametrize("make", [objects, lists])
def test_what_is_accepted_is_as_deep_as_the_server_takes(make: Any, module: str) -> None:
    metadata = ModuleMetadata(**{module: make(MOST_DEEP)})
    check_as_server(metadata, [])
    assert metadata_from_proto(metadata_to_proto(metadata)).part(module) or module == "custom"


@pytest.mark.parametrize("module", MODULES)
@pytest.mark.parametrize("depth", [MOST_DEEP + 1, 45, 64, 5000])
@pytest.mark.parametrize("make", [objects, lists])
def test_deeper_ones_are_refused_by_the_path_of_the_key(make: Any, depth: int, module: str) -> None:
    with pytest.raises(InvalidInputError, match=f"at most {MOST_DEEP}") as refused:
        render_request(POSE, ModuleMetadata(**{module: make(depth)}), [], [], DEFAULT_TRANSFER)
    inner = ".a" if make is objects else ".0"
    assert refused.value.field == f"metadata.{module}.a" + (MOST_DEEP - 1) * inner


def test_values_that_contain_themselves_or_a_deep_drive_are_refused() -> None:
    endless: dict[str, Any] = {}
    endless["again"] = [endless] * 10
    for values in (endless, objects(64)):
        with pytest.raises(InvalidInputError, match=r"drive\.a"):
            struct_to_proto(values, "drive")
    widening: Any = 1
    for _ in range(18):
        widening = [widening] * 10
    with pytest.raises(InvalidInputError, match="fields"):
        struct_to_proto({"a": widening}, "drive")
    with pytest.raises(InvalidInputError, match="as in JSON"):
        struct_to_proto({"a": 10**5000}, "drive")


@pytest.mark.parametrize(
    ("metadata", "told"),
    [
        (ModuleMetadata(custom={str(i): 1 for i in range(200_000)}), ("metadata.custom", "800000")),
        (ModuleMetadata(render={"effects": [1] * 100_000}), ("metadata.render", "200004")),
        (ModuleMetadata(custom={"a": "x" * 4_000_000}), ("metadata.custom", "4000023 bytes")),
        (
            ModuleMetadata(
                custom={f"k{i}": 1 for i in range(20_000)},
                asset={f"k{i}": 1 for i in range(20_001)},
            ),
            ("metadata.asset", "fields"),
        ),
        (
            ModuleMetadata(custom={"a": "x" * 2_000_000}, sensor={"a": "x" * 2_000_001}),
            ("metadata.sensor", "bytes"),
        ),
    ],
    ids=["keys", "list", "text", "keys of two modules", "texts of two modules"],
)
def test_too_large_ones_are_refused_by_module_size_and_bound(
    metadata: ModuleMetadata, told: tuple[str, str]
) -> None:
    with pytest.raises(InvalidInputError) as refused:
        batch_request(1.0, None, False, metadata, "")
    sentence = str(refused.value)
    assert refused.value.field == told[0]
    assert told[1] in sentence
    assert "at most" in sentence
    assert "for all modules together" in sentence
    assert len(sentence) < 300


@pytest.mark.parametrize(
    "custom",
    [{"a": "x" * 3_900_000}, {f"k{i}": 1 for i in range(31_700)}, {"a": [1] * 63_000}],
    ids=["text", "keys", "list"],
)
def test_the_largest_ones_leave_room_for_pose_and_names(custom: dict[str, Any]) -> None:
    check_as_server(ModuleMetadata(custom=custom), NAMES)


@pytest.fixture
def narrow_channel() -> Iterator[grpc.Channel]:
    """A connection to a server that takes requests of a kilobyte."""
    options = [("grpc.max_receive_message_length", 1000)]
    server = grpc.server(ThreadPoolExecutor(1), options=options)
    echo: Any = grpc.unary_unary_rpc_method_handler(lambda request, _: request)
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler("a.B", {"C": echo})])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    with grpc.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield channel
    server.stop(None)


def test_a_request_that_a_server_does_not_read_is_no_full_queue(
    narrow_channel: grpc.Channel,
) -> None:
    """Who sends it again later is refused again."""
    call: Any = narrow_channel.unary_unary("/a.B/C")
    with pytest.raises(InvalidInputError) as refused, translate_errors():
        call(b"x" * 1001)
    assert refused.value.field == "request"
    assert "1001 bytes" in str(refused.value)
    assert "at most 1000 bytes" in str(refused.value)
