"""Every conversion and its inverse; what passes between processes comes out as it went in."""

import contextlib
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from random_samples import BENT, POSE, PROVENANCE, T, assert_same, make_sample

from oaisys_core.errors import InvalidInputError, OaisysError, QueueFullError, WorkerLostError
from oaisys_core.types import (
    HeightQuery,
    LidarInfo,
    ModuleMetadata,
    PinholeIntrinsics,
    Progress,
    Sample,
    SensorInfo,
    SimulatorInfo,
    TriangleMesh,
)
from oaisys_grpc.client.sample_stream import SampleStream
from oaisys_grpc.contract import metadata, operation, sample_messages, world_messages
from oaisys_grpc.contract.arrays import CHUNK_BYTES, ArrayAssembly, array_chunks, raw_header
from oaisys_grpc.contract.errors import STATUS_CODES, error_from_status, status_from_error
from oaisys_grpc.contract.faults import ERROR_TYPES, error_from_fault, fault_from_error
from oaisys_grpc.contract.metadata import metadata_to_proto
from oaisys_grpc.contract.operation import (
    Kind,
    OperationStatus,
    State,
    status_from_proto,
    status_to_proto,
)
from oaisys_grpc.contract.sample_messages import (
    messages_from_bytes,
    messages_to_bytes,
    sample_from_messages,
    sample_to_messages,
)
from oaisys_grpc.contract.shared_memory import copy_to_segment, segment_of
from oaisys_grpc.contract.transfer import sample_to_parts
from oaisys_grpc.contract.world_messages import mesh_from_parts, mesh_to_message
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.worker.protocol import Connection, WorkerMessage

INTRINSICS = PinholeIntrinsics(640, 480, 541.14, 540.9, 319.5, 239.25)
FISHEYE = replace(INTRINSICS, distortion=(0.1, 0.0, -0.02, 0.001), distortion_model="equidistant")
METADATA = ModuleMetadata(
    sensor={
        "pose": POSE,
        "cameras": {"left": {"lens": {"f_number": 2.5}, "distortion": None}},
        "motion": {"kind": "random", "position_m": [[0, 1], [-1.5, 2], 3]},
    },
    environment={"sun_elevation_deg": 12.5, "sky_semantic_id": 3},
    asset={"count_factor": 0.5},
    render={"quality": "high"},
    custom={"weather": {"rain": True, "layers": [1, 2.5, "x", None], "deep": {"a": []}}},
)
INFO = SimulatorInfo(
    "analytic",
    "0.1.0",
    2**62,
    "b" * 64,
    "standard",
    (
        SensorInfo("left", INTRINSICS, T, ("rgb", "depth")),
        SensorInfo("right", BENT, T, ("normal", "flow", "semantic_9"), 0.25),
    ),
    {1: "gravel", 65535: "rock"},
    3,
    4,
    (-32.0, -31.0, 32.0, 33.0),
    2,
    "optix",
    (LidarInfo("roof", T, 0.05, ("instance",)),),
    rig_pose=POSE,
    odometry_drifts=True,
)
HEIGHTS = HeightQuery(np.array([0.5, np.nan]), np.array([1.0, np.nan]), np.array([-2.0, np.nan]))


MESH = TriangleMesh(
    np.random.default_rng(3).normal(size=(90_000, 3)),
    np.arange(30_000, dtype=np.int32).reshape(-1, 3),
    np.full(10_000, 7, np.uint16),
    np.full(10_000, 2**32 - 1, np.uint32),
)


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (metadata, "pose", POSE),
        (sample_messages, "intrinsics", INTRINSICS),
        (sample_messages, "intrinsics", FISHEYE),
        (sample_messages, "provenance", PROVENANCE),
        (operation, "progress", Progress("terrain", 0.25)),
        (sample_messages, "matrix", T),
        (metadata, "metadata", METADATA),
        (metadata, "metadata", ModuleMetadata()),
        (metadata, "metadata", ModuleMetadata(sensor={}, render={})),
        (world_messages, "info", INFO),
        (world_messages, "heights", HEIGHTS),
    ],
)
def test_a_value_comes_back_as_it_was(module: ModuleType, name: str, value: Any) -> None:
    message = getattr(module, f"{name}_to_proto")(value)
    if hasattr(message, "SerializeToString"):
        message = type(message).FromString(message.SerializeToString())
    assert_same(getattr(module, f"{name}_from_proto")(message), value)


def parts_of(sample: Sample) -> list[pb.SamplePart]:
    """The parts of a sample for a client that says nothing."""
    return list(sample_to_parts(sample_to_messages(sample)))


@pytest.mark.parametrize("size", [(480, 640), (1, 1), (1200, 1600)])
def test_a_sample_comes_back_from_its_parts(size: tuple[int, int]) -> None:
    sample = make_sample(*size)
    messages = [pb.GetSampleResponse(part=p).SerializeToString() for p in parts_of(sample)]
    assert max(len(message) for message in messages) < CHUNK_BYTES + 1024
    assert_same(
        SampleStream(pb.GetSampleResponse.FromString(m).part for m in messages).read(), sample
    )


def test_a_frame_says_its_camera_matrix() -> None:
    header = next(p.frame for p in parts_of(make_sample(4, 4)) if p.HasField("frame"))
    assert np.array_equal(np.reshape(header.k, (3, 3)), INTRINSICS.K)
    assert header.array.data_type == pb.DATA_TYPE_FLOAT32
    assert list(header.array.shape) == [4, 4]


@pytest.mark.parametrize("mesh", [MESH, TriangleMesh(MESH.vertices_m, MESH.triangles)])
def test_a_mesh_comes_back_from_its_parts(mesh: TriangleMesh) -> None:
    header, arrays = mesh_to_message(mesh)
    pieces = [c for i, data in enumerate(arrays) for c in array_chunks(data, i)]
    parts = [header, *(pb.GetGroundTruthMeshResponse(chunk=chunk) for chunk in pieces)]
    assert_same(mesh_from_parts(parts), mesh)


@pytest.mark.parametrize("missing", [0, 1, 2, 3, -1])
def test_a_stream_with_a_gap_is_refused(missing: int) -> None:
    parts = parts_of(make_sample(1200, 1600))
    del parts[missing]
    with pytest.raises(OaisysError):
        SampleStream(parts).read()


def test_a_header_that_contradicts_itself_allocates_nothing() -> None:
    header = raw_header(np.zeros((2, 2), np.float32))
    header.shape[0] = 2**40
    with pytest.raises(OaisysError, match="shape"):
        ArrayAssembly(header)


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        (ModuleMetadata(sensor={"pose": (0, 0, 0)}), "metadata.sensor.pose"),
        (ModuleMetadata(sensor={"cameras": object()}), "metadata.sensor"),
        (ModuleMetadata(environment={"sun": object()}), "metadata.environment"),
    ],
)
def test_metadata_that_no_message_can_hold_is_refused(metadata: ModuleMetadata, field: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        metadata_to_proto(metadata)
    assert refused.value.field == field


@pytest.mark.parametrize("name", sorted(ERROR_TYPES))
def test_every_error_has_a_status_and_comes_back(name: str) -> None:
    kind = ERROR_TYPES[name]
    assert kind in STATUS_CODES
    refused = kind is InvalidInputError
    error = InvalidInputError("a.0.b", [1, "x"], "y") if refused else kind("what happened")
    for back in (
        error_from_status(status_from_error(error)),
        error_from_fault(fault_from_error(error)),
    ):
        assert type(back) is kind
        assert str(back) == str(error)
        assert vars(back) == vars(error)


def test_an_error_of_a_third_party_comes_back_as_the_nearest_of_ours() -> None:
    class FullDiskError(QueueFullError):
        pass

    assert type(error_from_fault(fault_from_error(FullDiskError("x")))) is QueueFullError


@pytest.mark.parametrize(
    "status",
    [
        OperationStatus("operations/1", Kind.BATCH),
        OperationStatus(
            "operations/2", Kind.SAMPLE, State.SUCCEEDED, Progress("done", 1.0), None, 4, 5
        ),
    ],
)
def test_an_operation_comes_back_as_it_was(status: OperationStatus) -> None:
    assert status_from_proto(status_to_proto(status)) == status


def test_a_failed_operation_comes_back_with_its_error() -> None:
    error = WorkerLostError("gone")
    status = OperationStatus("operations/3", Kind.SAMPLE, State.FAILED, error=error)
    back = status_from_proto(status_to_proto(status)).error
    assert isinstance(back, WorkerLostError)
    assert str(back) == "gone"


def over_the_pipe(head: dict[str, Any], content: bytes, arrays: Sequence[Any]) -> WorkerMessage:
    """The message that arrives at the other end of a connection."""
    ours, theirs = map(Connection, socket.socketpair())
    with contextlib.closing(theirs):
        sender = threading.Thread(target=ours.send, args=(head, content, arrays))
        sender.start()
        arrived = theirs.receive()
        sender.join()
        ours.close()
        with pytest.raises(EOFError):
            theirs.receive()
    return arrived


@pytest.mark.parametrize("size", [(480, 640), (2, 2)])
def test_the_workers_protocol_carries_a_sample_unchanged(size: tuple[int, int]) -> None:
    sample = make_sample(*size)
    content, images = messages_to_bytes(sample_to_messages(sample))
    arrived = over_the_pipe({"type": "frames", "id": 3}, content, images)
    assert (arrived.type, arrived.head["id"]) == ("frames", 3)
    messages = messages_from_bytes(arrived.content, arrived.arrays)
    assert_same(sample_from_messages(messages), sample)


@pytest.mark.parametrize("arrays", [[], [np.eye(0)], [np.eye(3), np.arange(90_000.0)]])
def test_the_workers_protocol_carries_the_bytes_of_any_arrays(arrays: list[Any]) -> None:
    arrived = over_the_pipe({"type": "answer"}, b"content", arrays)
    assert arrived.content == b"content"
    assert [a.tobytes() for a in arrived.arrays] == [a.tobytes() for a in arrays]


def test_what_lies_in_shared_memory_is_passed_on_and_the_rest_goes_along() -> None:
    early, late = make_sample(120, 160), make_sample(240, 320)
    images = [[frame.data for frame in sample.frames] for sample in (early, late)]
    placed = [image for group in images for image in copy_to_segment(group)]
    for theirs, mine in zip(placed, (*images[0], *images[1]), strict=True):
        assert_same(theirs, mine)
        with pytest.raises(ValueError, match="read-only"):
            theirs[:] = 0
    arrays = [*placed, np.arange(100_000, dtype=np.float64), placed[0]]
    arrived = over_the_pipe({"type": "frames"}, b"", arrays).arrays
    assert [a.tobytes() for a in arrived] == [a.tobytes() for a in arrays]
    segments = [segment_of(array) for array in (*placed, *arrived[: len(placed)])]
    inodes = [os.fstat(s.descriptor).st_ino for s in segments if s is not None]
    assert len(inodes) == 2 * len(placed)
    assert inodes[: len(placed)] == inodes[len(placed) :]
    assert len(set(inodes)) == 2


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [("worker", "grpc"), ("server", "bpy"), ("server", "open3d"), ("client", "bpy")],
)
def test_a_process_does_not_load_what_is_not_its_own(module: str, unwanted: str) -> None:
    code = f"import sys, oaisys_grpc.{module}; sys.exit({unwanted!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=60)
    assert done.returncode == 0
