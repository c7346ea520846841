"""Samples frame by frame: depth and labels before colour, and what a failure takes back."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import numpy as np
import pytest
from served_simulator import FLAT_WORLD, Server, code_of
from waiting import PATIENCE_S

from oaisys_core.errors import DeadlineExceededError, NotFoundError, OaisysError, WorkerLostError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Frame, FrameName, ModuleMetadata, SampleOutline
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.metadata import metadata_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc

StartServer = Callable[..., Server]
SIZE = {"width_px": 32, "height_px": 24, "fx_px": 27.0, "fy_px": 27.0}
PAIR: dict[str, Any] = {
    **FLAT_WORLD,
    "sensors": {"cameras": [{**SIZE, "name": "left"}, {**SIZE, "name": "right"}]},
}
HEIGHT_M = 5.0
POSE = pose_looking_down(1.0, 2.0, HEIGHT_M)
NAMES = [(s, m) for s in ("left", "right") for m in ("rgb", "depth", "semantic_0", "instance")]
LATE = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": f"late-slow:{2 * PATIENCE_S:g}"}


@pytest.fixture(scope="module")
def pair_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Two cameras above a plane."""
    with Server(tmp_path_factory.mktemp("grpc") / "pair", PAIR) as server:
        yield server


@pytest.fixture(scope="module")
def late_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """As that, but colour takes longer than any test waits."""
    with Server(tmp_path_factory.mktemp("grpc") / "late", PAIR, **LATE) as server:
        yield server


def parts_of(server: Server) -> list[pb.SamplePart]:
    """The parts of one sample, as they come over the wire."""
    with grpc.insecure_channel(server.address) as channel:
        stub = simulator_pb2_grpc.SimulatorServiceStub(channel)
        metadata = metadata_to_proto(ModuleMetadata(sensor={"pose": POSE}))
        request = pb.RenderSampleRequest(metadata=metadata)
        events = stub.RenderSample(request, timeout=PATIENCE_S)
        return [event.part for event in events if event.HasField("part")]


def test_the_parts_come_in_the_order_that_the_contract_says(pair_server: Server) -> None:
    with pair_server.client() as client:
        client.step_batch()
    for from_cache in (False, True):
        check_order(parts_of(pair_server), from_cache)


def check_order(parts: list[pb.SamplePart], from_cache: bool) -> None:
    kinds = [part.WhichOneof("part") for part in parts]
    assert kinds[0] == "sample"
    assert kinds[-1] == "end"
    assert (kinds.count("sample"), kinds.count("end")) == (1, 1)
    header = parts[0].sample
    assert [(name.sensor, name.modality) for name in header.frames] == NAMES
    assert (header.frame_count, header.from_cache) == (len(NAMES), from_cache)
    frames = [part.frame for part in parts if part.HasField("frame")]
    assert [frame.modality == "rgb" for frame in frames] == [False] * 6 + [True] * 2
    for frame in frames:
        assert NAMES[frame.index] == (frame.sensor, frame.modality)
        assert frame.provenance.config_sha256 == header.provenance.config_sha256
    current = None
    for part in parts[1:-1]:
        current = part.frame.index if part.HasField("frame") else current
        assert part.HasField("frame") or part.chunk.index == current
    assert parts[-1].end.render_time_s > 0
    assert parts[-1].end.provenance.render_samples > 0
    assert parts[-1].end.provenance.device == "cpu"


def test_the_frames_that_came_early_are_those_of_the_sample(pair_server: Server) -> None:
    told: list[Frame] = []
    outlines: list[SampleOutline] = []

    with pair_server.client() as client:
        client.step_batch()
        with client.stream_sample(POSE) as stream:
            for frame in stream:
                assert isinstance(frame, Frame)
                outlines.append(stream.outline)
                told.append(frame)
            sample = stream.sample
        fetched = client.get_sample(sample.batch_id, sample.sample_id)
    assert [(f.sensor, f.modality) for f in sample.frames] == NAMES
    assert len(told) == len(NAMES)
    for frame in told:
        for whole in (sample, fetched):
            same = whole.frame(frame.sensor, frame.modality)
            np.testing.assert_array_equal(frame.data, same.data)
    for outline in outlines:
        assert (outline.batch_id, outline.sample_id) == (sample.batch_id, sample.sample_id)
        assert outline.frames == tuple(FrameName(*name) for name in NAMES)
        assert outline.rig_pose == POSE


def test_depth_is_there_while_colour_is_rendered(late_server: Server) -> None:
    with late_server.client() as client:
        client.step_batch()
        with client.stream_sample(POSE) as stream:
            early = list(itertools.islice(stream, 6))
            assert client.info().sample_id == 0
            with pytest.raises(OaisysError, match="incomplete"):
                _ = stream.sample
        depth = next(frame for frame in early if frame.modality == "depth")
        np.testing.assert_allclose(depth.data, HEIGHT_M, rtol=1e-6)
        assert {frame.modality for frame in early} == {"depth", "semantic_0", "instance"}
        assert settled(client) == 0


def settled(client: SimulatorClient) -> int:
    """The sample id, once the worker has nothing to do any more."""
    client.query_height([[0, 0, 3]])
    return client.info().sample_id


def test_a_deadline_after_depth_takes_the_sample_back(late_server: Server) -> None:
    came: list[str] = []
    with late_server.client() as client:
        client.step_batch()
        with (
            SimulatorClient(late_server.address, timeout_s=3.0) as hasty,
            pytest.raises(DeadlineExceededError),
            hasty.stream_sample(POSE) as stream,
        ):
            came.extend(frame.modality for frame in stream)
        assert settled(client) == 0
    assert "rgb" not in came


def test_a_batch_after_depth_aborts_the_sample(late_server: Server) -> None:
    begun = threading.Event()
    with late_server.client() as client, ThreadPoolExecutor() as pool:
        batch_id = client.step_batch()

        def render() -> None:
            with client.stream_sample(POSE) as stream:
                for _ in stream:
                    begun.set()

        rendering = pool.submit(render)
        assert begun.wait(PATIENCE_S)
        client.step_batch()
        with pytest.raises(OaisysError) as overtaken:
            rendering.result(PATIENCE_S)
        assert code_of(overtaken.value) == grpc.StatusCode.ABORTED
        with pytest.raises(NotFoundError):
            client.get_sample(batch_id, 1)
        assert settled(client) == 0


@pytest.mark.long
def test_a_crash_after_depth_takes_the_sample_back_and_its_id_goes_on(
    start_server: StartServer,
) -> None:
    came: list[FrameName] = []
    server = start_server(PAIR, OAISYS_TEST_BUILD="1", OAISYS_FAULT="late-crash@2")
    with server.client() as client:
        client.step_batch()
        assert client.render_sample(POSE).sample_id == 1
        pose = pose_looking_down(0, 0, HEIGHT_M)
        with pytest.raises(WorkerLostError), client.stream_sample(pose) as stream:
            came.extend(FrameName(f.sensor, f.modality) for f in stream)
        with pytest.raises(NotFoundError):
            client.get_sample(1, 2)
        client.wait_ready(PATIENCE_S)
        after = client.render_sample(pose_looking_down(0, 0, HEIGHT_M))
    assert came
    assert all(name.modality != "rgb" for name in came)
    assert (after.sample_id, len(after.frames)) == (2, len(NAMES))


@pytest.mark.long
@pytest.mark.blender
def test_blender_gives_depth_before_colour(start_server: StartServer) -> None:
    server = start_server({**PAIR, "backend": "blender"})
    with server.client() as client:
        client.step_batch()
    frames = [part.frame for part in parts_of(server) if part.HasField("frame")]
    assert [frame.modality == "rgb" for frame in frames] == [False] * 6 + [True] * 2
