"""A client of the original simulator: written from its wire format alone, with stubs of its own."""

from __future__ import annotations

import importlib.resources
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import grpc
import numpy as np
import OpenEXR
import psutil
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from grpc_tools import protoc
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from served_simulator import FLAT_WORLD, ROCKY_WORLD, Server
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.importing.frames import mount
from oaisys_grpc.client.simulator_client import SimulatorClient

StartServer = Callable[..., Server]

# As the original's, in the test's own words: nothing of ours is read.
PROTO = """
syntax = "proto3";
package oaisys;
service Oaisys {
  rpc StepBatch (StepBatchRequest) returns (StepBatchReply) {}
  rpc StepSample (StepSampleRequest) returns (StepSampleReply) {}
  rpc RenderFinished (Empty) returns (RenderFinishedReply) {}
  rpc BatchCreationFinished (Empty) returns (BatchCreationFinishedReply) {}
  rpc EndSimulation (Empty) returns (SuccessMsg) {}
}
message Empty {}
message SuccessMsg { bool successRet = 1; }
message StepBatchRequest {}
message StepBatchReply { bool successRet = 1; }
message SensorModuleRequest {
  message PoseType {
    float x = 1; float y = 2; float z = 3;
    float q_w = 4; float q_x = 5; float q_y = 6; float q_z = 7;
  }
  PoseType pose = 1;
}
message StepSampleRequest { SensorModuleRequest sensorModuleRequest = 1; }
message StepSampleReply { bool successRet = 1; int32 batchID = 2; int32 sampleID = 3; }
message RenderFinishedReply { int32 state = 1; repeated string filePathList = 2; }
message BatchCreationFinishedReply { int32 state = 1; }
"""

IDLE, BUSY, FINISHED = 0, 1, 2
LOOKING_DOWN = (1.0, 0.0, 0.0, 0.0)
"""w, x, y, z: Blender's camera looks along -z, so without any turn it looks down."""

CAMERA = {"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}
SLOW = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": "slow:1"}
ALL_PASSES = ["rgb", "depth", "semantic_0", "instance", "normal", "range"]


class OriginalClient:
    """Calls by method name, and the polling loop of the original's ROS client."""

    def __init__(self, folder: Path, address: str) -> None:
        (folder / "original.proto").write_text(PROTO)
        include = importlib.resources.files("grpc_tools") / "_proto"
        arguments = ["protoc", f"-I{folder}", f"-I{include}", f"-o{folder}/set", "original.proto"]
        assert protoc.main(arguments) == 0
        files = descriptor_pb2.FileDescriptorSet.FromString((folder / "set").read_bytes())
        pool = descriptor_pool.DescriptorPool()
        for file in files.file:
            pool.Add(file)
        self._service = pool.FindServiceByName("oaisys.Oaisys")
        self._types = {
            name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"oaisys.{name}"))
            for name in ("SensorModuleRequest", "SensorModuleRequest.PoseType")
        }
        self._channel = grpc.insecure_channel(address)
        self.why = ""

    def close(self) -> None:
        self._channel.close()

    def call(self, method: str, **fields: Any) -> Any:
        described = self._service.methods_by_name[method]
        request = message_factory.GetMessageClass(described.input_type)(**fields)
        call: Any = self._channel.unary_unary(
            f"/oaisys.Oaisys/{method}",
            request_serializer=lambda m: m.SerializeToString(),
            response_deserializer=message_factory.GetMessageClass(described.output_type).FromString,
        )
        reply, told = call.with_call(request, timeout=PATIENCE_S)
        self.why = str(dict(told.trailing_metadata() or ()).get("oaisys-error", ""))
        return reply

    def step_sample(
        self,
        xyz: tuple[float, float, float] | None,
        q_wxyz: tuple[float, float, float, float] = LOOKING_DOWN,
    ) -> Any:
        if xyz is None:
            return self.call("StepSample")
        keys = ("x", "y", "z", "q_w", "q_x", "q_y", "q_z")
        pose = self._types["SensorModuleRequest.PoseType"](
            **dict(zip(keys, (*xyz, *q_wxyz), strict=True))
        )
        return self.call(
            "StepSample", sensorModuleRequest=self._types["SensorModuleRequest"](pose=pose)
        )

    def wait_for_batch(self) -> None:
        self._poll("BatchCreationFinished")

    def wait_for_files(self) -> list[str]:
        return list(self._poll("RenderFinished").filePathList)

    def new_batch(self) -> None:
        assert self.call("StepBatch").successRet
        self.wait_for_batch()

    def _poll(self, method: str) -> Any:
        def finished() -> Any:
            reply = self.call(method)
            return reply if reply.state == FINISHED else None

        return wait_until(finished, explain=lambda: self.why)


@pytest.fixture
def connect(tmp_path: Path) -> Iterator[Callable[[Server], OriginalClient]]:
    clients: list[OriginalClient] = []

    def made(server: Server) -> OriginalClient:
        folder = tmp_path / f"client{len(clients)}"
        folder.mkdir()
        clients.append(OriginalClient(folder, server.address))
        return clients[-1]

    yield made
    for client in clients:
        client.close()


@pytest.fixture
def rocky(start_server: StartServer, tmp_path: Path) -> Server:
    camera = {**CAMERA, "name": "left", "modalities": ALL_PASSES}
    second = {**CAMERA, "name": "right", "mount_position_m": [0, -0.5, 0]}
    world = {**ROCKY_WORLD, "sensors": {"cameras": [camera, second]}}
    return start_server(world, "--legacy-out", str(tmp_path / "out"))


@pytest.mark.long
def test_the_originals_client_reads_the_frames_that_ours_gets(
    rocky: Server, connect: Callable[[Server], OriginalClient], tmp_path: Path
) -> None:
    client = connect(rocky)
    client.new_batch()
    reply = client.step_sample((1.0, 2.0, 14.0))
    assert (reply.successRet, reply.batchID, reply.sampleID) == (True, 1, 1)
    paths = client.wait_for_files()
    assert paths == client.wait_for_files()  # a second poll loses nothing
    depth = [path for path in paths if path.endswith("exr")][-1]
    colour = [path for path in paths if path.endswith("png")][-1]
    folder = tmp_path / "out/batch_0001/sensor_1"
    assert depth == str(folder / "0001sensor_1_pinhole_depth_00.exr")
    assert colour == str(folder / "0001sensor_1_rgb_00.png")
    names = {path.name for path in folder.glob("*.png")}
    assert {f"0001sensor_1_{kind}_label_00.png" for kind in ("semantic", "instance")} < names
    assert sorted(paths) == sorted(map(str, (tmp_path / "out").glob("*/sensor_?/0001*")))
    with rocky.client() as ours:
        sample = ours.get_sample(1, 1)
    frames = {frame.modality: frame.data for frame in sample.frames if frame.sensor == "left"}
    with OpenEXR.File(depth, separate_channels=True) as file:
        (channel,) = file.channels().values()
        assert channel.pixels.dtype == np.float32
        assert np.array_equal(channel.pixels, frames["depth"])
    assert np.array_equal(cv2.imread(colour)[..., ::-1], frames["rgb"])
    for kind, modality in (("semantic", "semantic_0"), ("instance", "instance")):
        file_name = str(folder / f"0001sensor_1_{kind}_label_00.png")
        label = cv2.imread(file_name, cv2.IMREAD_UNCHANGED)
        assert label.dtype == np.uint16
        assert np.array_equal(label, frames[modality])
    assert len(np.unique(frames["instance"])) > 2


@pytest.mark.long
def test_a_pose_is_that_of_the_sensor_base(
    start_server: StartServer,
    connect: Callable[[Server], OriginalClient],
    tmp_path: Path,
) -> None:
    """The depth of the plane z = 0 follows from Blender's axes alone, the mount included."""
    position_m, q_wxyz = (0.3, -0.2, 0.5), (0.96, 0.0, -0.28, 0.0)  # as an original file says it
    link = mount([*position_m, *q_wxyz])
    mounted = {"mount_position_m": link.position_m, "mount_quat_xyzw": link.quat_xyzw}
    world = {**FLAT_WORLD, "sensors": {"cameras": [{**CAMERA, **mounted}]}}
    client = connect(start_server(world, "--legacy-out", str(tmp_path / "out")))
    client.new_batch()
    for roll_deg in (0, 70):
        turn = Rotation.from_euler("ZYX", [30, roll_deg / 10, roll_deg], degrees=True)
        x, y, z, w = turn.as_quat()
        assert client.step_sample((2.0, -1.0, 6.0), (w, x, y, z)).successRet
        depth = next(path for path in client.wait_for_files() if path.endswith("exr"))
        with OpenEXR.File(depth, separate_channels=True) as file:
            (channel,) = file.channels().values()
        column, row = np.meshgrid(np.arange(64), np.arange(48))
        # Blender: x right, y up, looking along -z; the image's centre is at (31.5, 23.5).
        rays = np.stack(
            [(column - 31.5) / 54.114, -(row - 23.5) / 54.114, -np.ones((48, 64))], axis=-1
        )
        w, *xyz = q_wxyz
        camera = turn * Rotation.from_quat((*xyz, w))
        height_m = 6.0 + turn.apply(position_m)[2]
        down = camera.apply(rays.reshape(-1, 3)).reshape(48, 64, 3)[..., 2]
        expected = np.where(down < 0, -height_m / np.where(down < 0, down, -1.0), np.inf)
        on_stage = expected < 12  # the plane ends 20 m from its centre
        assert on_stage.sum() > 500
        assert_allclose(channel.pixels[on_stage], expected[on_stage], rtol=1e-5)
        assert np.isinf(channel.pixels[down >= 0]).all()


def _begun(client: OriginalClient, sample_id: int) -> Any:
    """How the sample stands, once it is no longer how the one before it stood."""
    reply = client.call("RenderFinished")
    before = IDLE if sample_id == 1 else FINISHED
    assert all(f"/{sample_id - 1:04d}" in path for path in reply.filePathList)
    return None if reply.state == before else reply


@pytest.mark.long
def test_states_tell_the_truth_and_overlapping_steps_are_refused(
    start_server: StartServer, connect: Callable[[Server], OriginalClient], tmp_path: Path
) -> None:
    """Nothing is finished before it is, or still finished when something else has begun."""
    options = ("--legacy-out", str(tmp_path / "out"))
    client = connect(start_server(FLAT_WORLD, *options, **SLOW))
    assert client.call("RenderFinished").state == IDLE
    assert client.call("BatchCreationFinished").state == IDLE
    refused = client.step_sample((0, 0, 5))
    assert (refused.successRet, refused.batchID, refused.sampleID) == (False, 0, 0)
    assert "batch" in client.why
    client.new_batch()
    for sample_id in (1, 2):
        with ThreadPoolExecutor(1) as pool:
            stepped = pool.submit(client.step_sample, (0, 0, 5.0 + sample_id))
            begun = wait_until(lambda: _begun(client, sample_id))  # noqa: B023
            assert (begun.state, list(begun.filePathList)) == (BUSY, [])
            reply = stepped.result(PATIENCE_S)
        assert (reply.successRet, reply.sampleID) == (True, sample_id)
        files = client.wait_for_files()
        assert all(f"/{sample_id:04d}" in path for path in files)
        assert all(Path(path).is_file() for path in files)
    assert client.call("StepBatch").successRet
    begun = client.call("RenderFinished")
    assert (begun.state, list(begun.filePathList)) == (IDLE, [])
    client.wait_for_batch()
    assert client.call("BatchCreationFinished").state == FINISHED
    refuse_overlapping_steps(client)


def refuse_overlapping_steps(client: OriginalClient) -> None:
    """They touch nothing."""
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(client.step_sample, (0, 0, 5))
        wait_until(lambda: client.call("RenderFinished").state == BUSY)
        assert not client.step_sample((0, 0, 9)).successRet
        assert "under way" in client.why
        assert not client.call("StepBatch").successRet
        assert first.result(PATIENCE_S).successRet
    (depth,) = [path for path in client.wait_for_files() if path.endswith("exr")]
    with OpenEXR.File(depth, separate_channels=True) as file:
        assert_allclose(next(iter(file.channels().values())).pixels, 5.0, rtol=1e-5)


NOT_FINITE = [
    ((float("nan"), 0, 5), LOOKING_DOWN, "pose.position"),
    ((0, float("inf"), 5), LOOKING_DOWN, "pose.position"),
    ((0, 0, 5), (1, 0, float("nan"), 0), "pose.orientation"),
]


@pytest.mark.parametrize(
    "q_wxyz", [(0.7, 0, 0, 0.7), (2, 0, 0.4, 0), (1e-30, 0, 1e-31, 0), (0, 0, 0, 0)]
)
def test_a_quaternion_of_any_length_is_a_rotation(
    flat_server: Server,
    flat_client: SimulatorClient,
    connect: Callable[[Server], OriginalClient],
    q_wxyz: tuple[float, float, float, float],
) -> None:
    """Blender normalises; zeros are a half turn about x there."""
    client = connect(flat_server)
    client.new_batch()
    reply = client.step_sample((0, 0, 5), q_wxyz)
    assert reply.successRet, client.why
    assert client.wait_for_files()
    w, *xyz = q_wxyz if any(q_wxyz) else (0, 1, 0, 0)
    axes = Rotation.from_quat((*xyz, w)).as_matrix()
    pose = flat_client.get_sample(reply.batchID, reply.sampleID).rig_pose
    # The link's x is the base's -z, its z the base's y.
    link = Rotation.from_quat(pose.quat_xyzw).as_matrix()
    assert_allclose(link[:, 0], -axes[:, 2], atol=1e-6)
    assert_allclose(link[:, 2], axes[:, 1], atol=1e-6)


@pytest.mark.parametrize(("xyz", "q_wxyz", "field"), NOT_FINITE)
def test_numbers_that_are_not_finite_keep_the_last_pose(
    flat_server: Server,
    flat_client: SimulatorClient,
    connect: Callable[[Server], OriginalClient],
    xyz: tuple[float, float, float],
    q_wxyz: tuple[float, float, float, float],
    field: str,
) -> None:
    client = connect(flat_server)
    client.new_batch()
    assert client.step_sample((1, 2, 7)).successRet
    client.wait_for_files()
    reply = client.step_sample(xyz, q_wxyz)
    assert reply.successRet, client.why
    assert client.wait_for_files()
    pose = flat_client.get_sample(reply.batchID, reply.sampleID).rig_pose
    assert_allclose(pose.position_m, (1, 2, 7), atol=1e-6)
    assert f"sensorModuleRequest.{field}" in flat_server.stderr.read_text()
    assert client.step_sample(None).successRet  # without a pose it stays where it is, too
    client.wait_for_files()
    after = flat_client.get_sample(reply.batchID, reply.sampleID + 1).rig_pose
    assert_allclose(after.position_m, (1, 2, 7), atol=1e-6)


@pytest.mark.long
def test_the_client_comes_to_its_end_whatever_is_refused(
    start_server: StartServer, connect: Callable[[Server], OriginalClient], tmp_path: Path
) -> None:
    """The original's own client polls until a step is finished, and does not look at the reply."""
    options = ("--legacy-out", str(tmp_path / "out"), "--legacy-pose-policy", "reject")
    client = connect(start_server(FLAT_WORLD, *options))
    assert not client.step_sample((0, 0, 5)).successRet  # no batch yet
    assert client.wait_for_files() == []
    assert "batch" in client.why
    places = [*UNDER_AND_OFF, (0, 0, 1e30)]
    refused = [*((xyz, LOOKING_DOWN, "pose.position") for xyz in places), *NOT_FINITE]
    for xyz, q_wxyz, field in refused:
        client.new_batch()
        assert not client.step_sample(xyz, q_wxyz).successRet
        assert client.wait_for_files() == []
        assert field in client.why
    assert client.step_sample((0, 0, 5)).successRet
    files = client.wait_for_files()
    assert files
    for xyz, q_wxyz, _ in refused:  # a sample that was refused leaves the one before
        assert not client.step_sample(xyz, q_wxyz).successRet
        assert client.wait_for_files() == files


@pytest.mark.long
def test_a_batch_that_fails_is_finished_and_says_why(
    start_server: StartServer, connect: Callable[[Server], OriginalClient]
) -> None:
    client = connect(start_server(FLAT_WORLD, OAISYS_TEST_BUILD="1", OAISYS_FAULT="batch-crash"))
    assert client.call("StepBatch").successRet
    client.wait_for_batch()
    assert client.why
    assert not client.step_sample((0, 0, 5)).successRet
    assert client.wait_for_files() == []
    assert client.why
    assert client.call("EndSimulation").successRet


UNDER_AND_OFF = ((0, 0, -5), (90, 0, 5))


def test_a_pose_off_the_stage_or_under_it_is_clamped(
    flat_server: Server,
    flat_client: SimulatorClient,
    connect: Callable[[Server], OriginalClient],
) -> None:
    """The original's own client polls for ever for a sample that was refused."""
    client = connect(flat_server)
    client.new_batch()
    for xyz, expected in zip(UNDER_AND_OFF, ((0, 0, 0.05), (20, 0, 5)), strict=True):
        reply = client.step_sample(xyz)
        assert reply.successRet, client.why
        assert client.wait_for_files()
        sample = flat_client.get_sample(reply.batchID, reply.sampleID)
        assert_allclose(sample.rig_pose.position_m, expected, atol=1e-6)
    with pytest.raises(InvalidInputError, match=r"pose\.position"):  # of our own service
        flat_client.render_sample(pose_looking_down(90, 0, 5))


@pytest.fixture(scope="module")
def rejecting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that rejects poses; a file stands where its folder should be."""
    folder = tmp_path_factory.mktemp("rejecting")
    (folder / "out").write_text("in the way")
    options = ("--legacy-out", str(folder / "out"), "--legacy-pose-policy", "reject")
    with Server(folder / "server", FLAT_WORLD, *options) as server:
        yield server


@pytest.mark.long
def test_a_pose_off_the_stage_or_under_it_is_refused_on_request(
    rejecting: Server, connect: Callable[[Server], OriginalClient]
) -> None:
    client = connect(rejecting)
    client.new_batch()
    for xyz in UNDER_AND_OFF:
        assert not client.step_sample(xyz).successRet
        assert "pose.position" in client.why


def test_a_failed_step_is_finished_without_files_and_says_why(
    rejecting: Server, connect: Callable[[Server], OriginalClient]
) -> None:
    client = connect(rejecting)
    client.new_batch()
    assert client.step_sample((0, 0, 5)).successRet
    wait_until(lambda: client.call("RenderFinished").state != BUSY)
    reply = client.call("RenderFinished")
    assert (reply.state, list(reply.filePathList)) == (FINISHED, [])
    assert "could not be written" in client.why


@pytest.mark.long
def test_a_second_run_leaves_the_files_of_the_first(
    start_server: StartServer, connect: Callable[[Server], OriginalClient], tmp_path: Path
) -> None:
    written: list[str] = []
    for _ in range(2):
        client = connect(start_server(FLAT_WORLD, "--legacy-out", str(tmp_path / "out")))
        client.new_batch()
        assert client.step_sample((0, 0, 5)).successRet
        written += client.wait_for_files()
    assert len(set(written)) == len(written)
    assert all(Path(path).is_file() for path in written)
    assert os.path.commonpath(written) == str(tmp_path / "out")


@pytest.mark.long
def test_end_simulation_ends_the_server(
    start_server: StartServer, connect: Callable[[Server], OriginalClient]
) -> None:
    server = start_server(FLAT_WORLD)
    client = connect(server)
    worker = server.worker()
    assert client.call("EndSimulation").successRet
    assert server.process.wait(PATIENCE_S) == 0
    psutil.wait_procs([worker], PATIENCE_S)
    assert not worker.is_running()
