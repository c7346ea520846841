"""Which way frames travel, that all ways bring the same bits, and that a client falls back."""

import contextlib
import fcntl
import gc
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import psutil
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_samples import assert_same, make_sample
from served_simulator import ROCKY_WORLD, Server, code_of, stepped_server
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import InvalidInputError, NotFoundError, OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Frame, Sample
from oaisys_grpc.client.sample_stream import SampleStream
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.sample_messages import sample_to_messages
from oaisys_grpc.contract.shared_memory import (
    MemoryLocation,
    Probe,
    Reader,
    Segment,
    SharedMemoryError,
    copy_to_segment,
    find_token,
    location_of,
    open_location,
    segment_of,
)
from oaisys_grpc.contract.transfer import (
    DEFAULT_TRANSFER,
    Transfer,
    frame_response,
    grant,
    location_from_proto,
    sample_to_parts,
    transfer_from_proto,
    transfer_to_proto,
)
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc

StartServer = Callable[..., Server]
CAMERA = {"width_px": 320, "height_px": 240, "fx_px": 270.0, "fy_px": 270.0}
WORLD = {**ROCKY_WORLD, "sensors": {"cameras": [CAMERA]}}
POSE = pose_looking_down(1, 2, 7)

TRANSFERS = st.builds(
    Transfer,
    encodings=st.lists(st.sampled_from([1, 2, 3, 99]), unique=True).map(tuple),
    inline_bytes=st.integers(0, 200_000),
    chunk_bytes=st.integers(1_000, 500_000),
    grouped=st.booleans(),
    group_bytes=st.integers(0, 500_000),
)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with stepped_server(tmp_path_factory.mktemp("transfer") / "rocky", WORLD) as server:
        yield server


def clients(server: Server) -> dict[str, SimulatorClient]:
    """One client for each way."""
    address = server.address
    return {
        "shared memory": SimulatorClient(address, timeout_s=PATIENCE_S),
        "raw": SimulatorClient(address, timeout_s=PATIENCE_S, shared_memory=False),
        "encoded": SimulatorClient(
            address,
            timeout_s=PATIENCE_S,
            shared_memory=False,
            encodings=("png", "shuffled_zlib"),
        ),
    }


def parts_of(sample: Sample, wanted: Transfer = DEFAULT_TRANSFER) -> list[pb.SamplePart]:
    """Parts of a sample as they come over a channel."""
    parts = sample_to_parts(sample_to_messages(sample), wanted)
    return [pb.SamplePart.FromString(part.SerializeToString()) for part in parts]


def mapped_files() -> int:
    """How many files of shared memory this process has mapped."""
    return Path("/proc/self/maps").read_text().count("/memfd:oaisys")


def descriptors() -> int:
    """How many of files of shared memory this process has open."""
    gc.collect()
    count = 0
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # it was closed meanwhile
            count += str(link.readlink()).startswith("/memfd:oaisys")
    return count


def lies_in_shared_memory(frame: Frame) -> bool:
    return location_of(frame.data) is not None


@given(TRANSFERS)
@settings(max_examples=40, deadline=None)
def test_a_sample_comes_back_whichever_way_it_goes(wanted: Transfer) -> None:
    sample = make_sample(60, 80)
    parts = parts_of(sample, wanted)
    groups = [list(p.group.parts) if p.HasField("group") else [p] for p in parts]
    chunks_of = [[p.chunk for p in group if p.HasField("chunk")] for group in groups]
    assert all(len(chunk.data) <= wanted.chunk_bytes for group in chunks_of for chunk in group)
    in_groups = [c for c, p in zip(chunks_of, parts, strict=True) if p.HasField("group")]
    assert all(sum(len(c.data) for c in group) <= wanted.group_bytes for group in in_groups)
    inline = [sum(len(p.frame.data) for p in group) for group in groups]
    assert all(size <= wanted.inline_bytes for size in inline)
    assert_same(SampleStream(parts).read(), sample)
    again = transfer_from_proto(transfer_to_proto(wanted))
    assert again == wanted


def test_a_small_sample_is_one_message_where_the_client_takes_groups() -> None:
    sample = make_sample(48, 64)
    wanted = Transfer(inline_bytes=1 << 20, grouped=True)
    (part,) = parts_of(sample, wanted)
    assert len(part.group.parts) == len(sample.frames) + 2
    assert_same(SampleStream([part]).read(), sample)


def test_a_sample_says_when_its_last_frame_existed(server: Server) -> None:
    for name, client in clients(server).items():
        with client:
            for _ in range(2):  # rendered, and found in the cache
                begun_ns = time.monotonic_ns()
                sample = client.render_sample(POSE)
                came_ns = time.monotonic_ns()
                assert begun_ns < sample.finished_ns < came_ns, name
            fetched = client.get_sample(sample.batch_id, sample.sample_id)
            assert fetched.finished_ns == sample.finished_ns


def test_every_way_brings_the_same_bits(server: Server) -> None:
    rendered = {}
    for name, client in clients(server).items():
        with client:
            rendered[name] = client.render_sample(POSE)
            fetched = client.get_sample(rendered[name].batch_id, rendered[name].sample_id)
        assert_same(fetched, rendered[name])
        shared = [lies_in_shared_memory(f) for f in (*fetched.frames, *rendered[name].frames)]
        assert all(shared) if name == "shared memory" else not any(shared)
    for sample in rendered.values():
        for a, b in zip(sample.frames, rendered["raw"].frames, strict=True):
            assert_same(a, b)


def test_frames_come_before_the_end_whichever_way(server: Server) -> None:
    for number, client in enumerate(clients(server).values()):
        with client, client.stream_sample(pose_looking_down(-1, number, 6)) as stream:
            seen = [(stream.outline, frame) for frame in stream]
            sample = stream.sample
        assert {id(f) for _, f in seen} == {id(f) for f in sample.frames}
        assert seen[-1][1].modality == "rgb"
        assert all(o.sample_id == sample.sample_id for o, _ in seen)


def test_arrays_belong_to_who_received_them(server: Server) -> None:
    for client in clients(server).values():
        with client:
            sample = client.render_sample(POSE)
            depth = sample.frame("camera", "depth").data
            depth[:] = -1
            again = client.get_sample(sample.batch_id, sample.sample_id)
        assert (again.frame("camera", "depth").data > 0).all()


@pytest.mark.long
def test_a_server_may_keep_its_memory_to_itself(start_server: StartServer) -> None:
    server = start_server(WORLD, "--no-shared-memory")
    with server.client() as client:
        client.step_batch(seed=3)
        sample = client.render_sample(POSE)
    assert not any(lies_in_shared_memory(frame) for frame in sample.frames)
    with grpc.insecure_channel(server.address) as channel:
        info = simulator_pb2_grpc.SimulatorServiceStub(channel).GetSimulatorInfo(
            pb.GetSimulatorInfoRequest()
        )
    assert not info.HasField("shared_memory_probe")


def plain_stub(server: Server) -> Any:
    return simulator_pb2_grpc.SimulatorServiceStub(grpc.insecure_channel(server.address))


def test_memory_is_offered_to_none_but_those_who_read_it(server: Server) -> None:
    stub = plain_stub(server)
    info = stub.GetSimulatorInfo(pb.GetSimulatorInfoRequest())
    place = location_from_proto(info.shared_memory_probe)
    assert place.token == b""
    token = find_token(place)
    with server.client() as client:
        sample = client.render_sample(POSE)
    for guess, shared in ((token, True), (b"", False), (bytes(32), False), (token[:-1], False)):
        options = pb.TransferOptions(shared_memory_token=guess)
        request = pb.GetSampleRequest(
            batch_id=sample.batch_id, sample_id=sample.sample_id, transfer=options
        )
        frames = [a.part.frame for a in stub.GetSample(request) if a.part.HasField("frame")]
        assert [f.HasField("shared_memory") for f in frames] == [shared] * len(sample.frames)


def test_a_client_that_says_nothing_gets_plain_chunks(server: Server) -> None:
    """The contract as first released."""
    stub = plain_stub(server)
    parts = [a.part for a in stub.RenderSample(pb.RenderSampleRequest()) if a.HasField("part")]
    kinds = {part.WhichOneof("part") for part in parts}
    assert kinds == {"sample", "frame", "chunk", "end"}
    frames = [part.frame for part in parts if part.HasField("frame")]
    assert all(f.WhichOneof("content") is None for f in frames)
    assert all(f.array.encoding == pb.ENCODING_RAW for f in frames)
    assert [len(p.chunk.data) for p in parts if p.HasField("chunk")] == [
        f.array.byte_size for f in frames
    ]


def test_one_frame_in_one_message(server: Server) -> None:
    stub = plain_stub(server)
    with server.client() as client:
        sample = client.render_sample(POSE)
    ids: dict[str, Any] = {"batch_id": sample.batch_id, "sample_id": sample.sample_id}
    for encodings in ([], [pb.ENCODING_PNG, pb.ENCODING_SHUFFLED_ZLIB]):
        request = pb.GetFrameRequest(
            **ids, sensor="camera", modality="depth", accepted_encodings=encodings
        )
        answer = stub.GetFrame(request)
        parts = [pb.SamplePart(frame=answer.frame)]
        (frame,) = SampleStream(parts)
        assert_same(frame, sample.frame("camera", "depth"))
        assert answer.sample.sample_id == sample.sample_id
        assert len(answer.frame.data) == answer.frame.array.byte_size
    with pytest.raises(grpc.RpcError) as missing:
        stub.GetFrame(pb.GetFrameRequest(**ids, sensor="camera", modality="smell"))
    assert missing.value.code() == grpc.StatusCode.NOT_FOUND


def test_a_frame_too_large_for_one_message_is_refused() -> None:
    name = make_sample(2, 2).outline.frames[1]
    sample = sample_to_messages(make_sample(1200, 1600))
    with pytest.raises(InvalidInputError, match="GetSample"):
        frame_response(sample, name, ())
    with pytest.raises(NotFoundError, match="nose/depth"):
        frame_response(sample, replace(name, sensor="nose"), ())


def test_limits_hold_on_both_sides(server: Server) -> None:
    info = plain_stub(server).GetSimulatorInfo(pb.GetSimulatorInfoRequest())
    limits = info.transfer_limits
    assert limits.max_chunk_bytes < 4 << 20
    assert list(limits.encodings) == [
        pb.ENCODING_RAW,
        pb.ENCODING_PNG,
        pb.ENCODING_SHUFFLED_ZLIB,
    ]
    with SimulatorClient(server.address, timeout_s=PATIENCE_S, max_array_bytes=100_000) as client:
        with pytest.raises(InvalidInputError) as refused:
            client.render_sample(POSE)
        assert refused.value.field == "transfer.max_frame_bytes"
        assert code_of(refused.value) == grpc.StatusCode.INVALID_ARGUMENT
        with pytest.raises(OaisysError, match="100000 at most"):
            client.ground_truth_mesh()
    huge = Transfer(inline_bytes=1 << 31, chunk_bytes=1 << 31)
    transfer = grant(huge, None)
    assert transfer.inline_bytes == limits.max_inline_bytes
    assert transfer.chunk_bytes == limits.max_chunk_bytes
    with pytest.raises(InvalidInputError, match=r"transfer\.max_chunk_bytes.*at least 1000"):
        grant(Transfer(chunk_bytes=1), None)


def test_a_stream_with_a_frame_beyond_the_limit_is_refused_at_its_header() -> None:
    header, *_ = (p for p in parts_of(make_sample(60, 80)) if p.HasField("frame"))
    header.frame.array.shape[0] = 2**31
    header.frame.array.byte_size = 2**31 * 80 * 3
    with pytest.raises(OaisysError, match="this client takes 1000 at most"):
        list(SampleStream([header], limit=1000))


def shared_parts(sample: Sample) -> tuple[list[Any], Segment]:
    """Parts of a sample whose frames lie in a file of this process."""
    images = copy_to_segment([frame.data for frame in sample.frames])
    segment = segment_of(images[0])
    assert segment is not None
    frames = tuple(replace(f, data=i) for f, i in zip(sample.frames, images, strict=True))
    shared = replace(sample, frames=frames)
    wanted = Transfer(token=bytes(32))
    return parts_of(shared, wanted), segment


def test_what_cannot_be_read_there_is_fetched() -> None:
    sample = make_sample(60, 80)
    parts, segment = shared_parts(sample)
    stream = SampleStream(parts, reader=Reader())
    assert_same(stream.read(), sample)
    assert stream.largest_copied_bytes == 0
    parts[2].frame.shared_memory.token = bytes(32)
    asked: list[tuple[int, int]] = []

    def fetch(batch_id: int, sample_id: int) -> Sample:
        asked.append((batch_id, sample_id))
        return sample

    assert_same(SampleStream(parts, reader=Reader(), fetch=fetch).read(), sample)
    assert_same(SampleStream(parts, fetch=fetch).read(), sample)
    assert asked == [(sample.batch_id, sample.sample_id)] * 2
    with pytest.raises(OaisysError, match="incomplete"):
        SampleStream(parts, reader=Reader()).read()
    del segment


def a_file(content: bytes = bytes(100)) -> tuple[MemoryLocation, Segment]:
    (array,) = copy_to_segment([np.frombuffer(content, np.uint8)])
    segment = segment_of(array)
    assert segment is not None
    return segment.location(segment.offset_of(array)), segment


def test_a_file_neither_changes_nor_shrinks() -> None:
    _, segment = a_file()
    with pytest.raises(PermissionError):
        os.pwrite(segment.descriptor, b"x", 0)
    with pytest.raises(PermissionError):
        os.ftruncate(segment.descriptor, 10)
    with pytest.raises(PermissionError):
        fcntl.fcntl(segment.descriptor, fcntl.F_ADD_SEALS, 0)


def test_nothing_else_is_taken_for_shared_memory(tmp_path: Path) -> None:
    place, segment = a_file()
    os.close(open_location(place))
    unsealed = os.memfd_create("oaisys")
    os.ftruncate(unsealed, place.file_size)
    os.write(unsealed, place.token)
    plain = os.open(tmp_path / "plain", os.O_RDWR | os.O_CREAT)
    os.ftruncate(plain, place.file_size)
    ours, theirs = os.pipe()
    os.write(theirs, b"theirs")
    for wrong in (
        place._replace(token=bytes(32)),
        place._replace(file_size=place.file_size + 1),
        place._replace(descriptor=unsealed),
        place._replace(descriptor=plain),
        place._replace(descriptor=ours),
        place._replace(descriptor=99_999),
        place._replace(process_id=2**31 - 1),
        place._replace(process_id=1),
    ):
        with pytest.raises(SharedMemoryError):
            open_location(wrong)
    reader = Reader()
    for wrong in (place._replace(token=b""), place._replace(offset=place.file_size)):
        with pytest.raises(SharedMemoryError):
            reader.read(wrong, 10, {})
    assert os.read(ours, 100) == b"theirs"
    for descriptor in (unsealed, plain, ours, theirs):
        os.close(descriptor)
    del segment


def test_a_probe_is_proved_by_its_content_alone() -> None:
    probe = Probe()
    assert probe.location.token == b""
    assert probe.proves(find_token(probe.location))
    assert not probe.proves(b"")
    assert not probe.proves(bytes(32))


def test_kept_arrays_take_bounded_descriptors_and_stay_as_they_are() -> None:
    """More files than are mapped are copied."""
    before = descriptors()
    reader = Reader(max_files=4)
    kept: list[Any] = []
    files: dict[bytes, Segment] = {}
    for number in range(20):
        place, segment = a_file(bytes([number]) * 1000)
        kept.append(reader.read(place, 1000, files))
        del segment
    del files
    gc.collect()
    assert descriptors() <= before + 2 * 4
    for number, array in enumerate(kept):
        assert (array == number).all()
        array[:] = 0
    del kept, array
    gc.collect()
    assert descriptors() == before


def test_large_files_are_copied_rather_than_kept() -> None:
    reader = Reader(max_bytes=5000)
    place, segment = a_file(bytes(range(250)) * 40)
    array = reader.read(place, 10_000, {})
    assert location_of(array) is None
    assert array.tobytes() == bytes(range(250)) * 40
    del segment


@pytest.mark.long
def test_a_killed_server_leaves_nothing_and_the_next_one_is_found(
    start_server: StartServer,
) -> None:
    """What a client holds stays as it was."""
    gc.collect()  # samples of earlier tests, which an exception's traceback may hold
    before = mapped_files()
    first = start_server(WORLD)
    port = first.address.rpartition(":")[2]
    with first.client() as client:
        client.step_batch(seed=3)
        held = client.render_sample(POSE)
        copies = [frame.data.copy() for frame in held.frames]
        assert all(lies_in_shared_memory(frame) for frame in held.frames)
        worker = first.worker()
        first.process.kill()
        first.process.wait()
        wait_until(lambda: not worker.is_running() or worker.status() == psutil.STATUS_ZOMBIE)
        assert all(np.array_equal(f.data, c) for f, c in zip(held.frames, copies, strict=True))
        assert not [path for path in Path("/dev/shm").iterdir() if "oaisys" in path.name]
        assert mapped_files() > before
        del held
        gc.collect()
        assert mapped_files() == before

        second = start_server(WORLD, "--address", f"127.0.0.1:{port}")
        assert second.address == first.address
        client.wait_ready(PATIENCE_S)
        client.step_batch(seed=3)
        sample = client.render_sample(POSE)
        with SimulatorClient(second.address, timeout_s=PATIENCE_S, shared_memory=False) as other:
            assert_same(other.get_sample(1, 1), sample)
        wait_until(lambda: all(map(lies_in_shared_memory, client.get_sample(1, 1).frames)))
