"""The service from end to end, on the analytic backend."""

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest
from commands import oaisys_here
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import (
    ProtoReflectionDescriptorDatabase,
)
from served_simulator import FLAT_WORLD, ROCKY_WORLD, Server, code_of, stepped_server
from waiting import PATIENCE_S

from oaisys_core.config import config_from_mapping, config_sha256
from oaisys_core.errors import InvalidInputError, NotFoundError, NotReadyError
from oaisys_core.geometry import pixel_rays, pose_looking_at, pose_looking_down
from oaisys_core.sensing.faults import CaptureId, DepthFaults, PoseDrift, measure_depth
from oaisys_core.types import ModuleMetadata, Odometry, Pose, Progress
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.operation import State

StartServer = Callable[..., Server]
NADIR = pose_looking_down(1, 2, 7)


def test_depth_of_a_plane_is_as_the_closed_form_says(flat_client: SimulatorClient) -> None:
    """A ray with direction d from height h meets z = 0 at the planar depth -h / d_z."""
    pose = pose_looking_at((-3, 1, 6), (2, -1, 0))
    frame = flat_client.render_sample(pose).frame("camera", "depth")
    rays_map = pixel_rays(frame.intrinsics) @ frame.T_map_camera[:3, :3].T
    np.testing.assert_allclose(frame.data, -6 / rays_map[..., 2], rtol=1e-5)
    assert frame.data.dtype == np.float32
    assert frame.T_map_camera[:3, 3] == pytest.approx((-3, 1, 6))


def test_a_sample_says_where_it_is_from(flat_client: SimulatorClient) -> None:
    sample = flat_client.render_sample(NADIR)
    info = flat_client.info()
    assert sample.rig_pose == NADIR
    assert (sample.batch_id, sample.sample_id) == (info.batch_id, info.sample_id)
    assert sample.provenance.config_sha256 == info.config_sha256
    assert sample.provenance.backend == info.backend == "analytic"
    assert [f.modality for f in sample.frames] == list(info.sensors[0].modalities)
    assert sample.frames[0].intrinsics == info.sensors[0].intrinsics
    assert info.stage_extent_m == (-20, -20, 20, 20)


@pytest.mark.long
def test_noise_and_drift_come_with_the_frames_after_a_batch_and_can_be_switched_off(
    start_server: StartServer,
) -> None:
    faults = {"depth_noise": "gaussian", "depth_sigma_m": 0.5, "drift_m": 0.25, "seed": 4}
    config = {**FLAT_WORLD, "sensors": {**FLAT_WORLD.get("sensors", {}), "faults": faults}}
    with start_server(config).client() as client:
        assert client.info().batch_id == 0
        with pytest.raises(NotReadyError, match="batch"):
            client.render_sample(NADIR)
        client.step_batch()
        first = client.render_sample(NADIR)
        second = client.render_sample(NADIR)
        off = ModuleMetadata(sensor={"faults": {"enabled": False}})
        truth = client.render_sample(NADIR, metadata=off)
    true_m = truth.frame("camera", "depth").data
    for sample in (first, second):
        error_m = sample.frame("camera", "depth").data - true_m
        assert 0.4 < float(np.std(error_m)) < 0.6
        capture = CaptureId(sample.batch_id, sample.sample_id, "camera")
        expected_m = measure_depth(true_m, 1.0, DepthFaults(4, "gaussian", 0.5), capture)
        np.testing.assert_array_equal(sample.frame("camera", "depth").data, expected_m)
    drifted = PoseDrift().estimate(NADIR, (0.25, 0.0), 4, second.batch_id, second.sample_id)
    assert second.odometry == Odometry(drifted, 0.25, 0.0)
    assert truth.odometry is None
    assert '"enabled":false' in truth.provenance.metadata_json


def test_the_configuration_is_told_to_who_asks(flat_client: SimulatorClient) -> None:
    config = config_from_mapping(json.loads(flat_client.config_json()))
    assert config_sha256(config) == flat_client.info().config_sha256


def test_only_the_modalities_asked_for_come(flat_client: SimulatorClient) -> None:
    sample = flat_client.render_sample(NADIR, modalities=["depth"], sensors=["camera"])
    assert [f.modality for f in sample.frames] == ["depth"]


def test_a_long_value_is_refused_as_what_it_is(flat_client: SimulatorClient) -> None:
    with pytest.raises(InvalidInputError) as caught:
        flat_client.render_sample(
            metadata=ModuleMetadata(environment={"sun" * 10_000: "x" * 20_000})
        )
    assert caught.value.field.startswith("metadata.environment.sun")


def test_progress_is_told_before_the_frames(flat_client: SimulatorClient) -> None:
    seen: list[Progress] = []
    flat_client.step_batch(on_progress=seen.append)
    fractions = [progress.fraction for progress in seen]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_the_operations_way_gives_the_same_sample(flat_client: SimulatorClient) -> None:
    name = flat_client.start_batch(seed=7)
    *_, batch = flat_client.watch_operation(name)
    assert (batch.state, batch.sample_id) == (State.SUCCEEDED, 0)
    *_, done = flat_client.watch_operation(flat_client.start_sample(NADIR))
    assert flat_client.get_operation(done.name) == done
    assert (done.batch_id, done.sample_id) == (batch.batch_id, 1)
    first = flat_client.get_sample(done.batch_id, done.sample_id)
    second = flat_client.render_sample()
    assert first.rig_pose == second.rig_pose == NADIR
    for a, b in zip(first.frames, second.frames, strict=True):
        assert np.array_equal(a.data, b.data)


def test_heights_of_a_plane(flat_client: SimulatorClient) -> None:
    heights = flat_client.query_height(np.array([[0, 0, 5], [3, -2, 0.5], [500, 0, 0]]))
    np.testing.assert_allclose(heights.ground_height_m, [0, 0, np.nan], atol=1e-6)
    np.testing.assert_allclose(heights.clearance_m, [5, 0.5, np.nan], atol=1e-6)


def test_more_heights_than_fit_a_message(flat_client: SimulatorClient) -> None:
    points_m = np.random.default_rng(0).uniform(-19, 19, (250_000, 3))
    heights = flat_client.query_height(points_m)
    np.testing.assert_allclose(heights.clearance_m, points_m[:, 2], atol=1e-6)


@pytest.fixture(scope="module")
def rocky_client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatorClient]:
    """A client of a server with rocks; a first batch stands."""
    folder = tmp_path_factory.mktemp("rocky") / "server"
    with stepped_server(folder, ROCKY_WORLD) as server, server.client() as client:
        yield client


def test_the_mesh_is_the_surface_that_was_rendered(rocky_client: SimulatorClient) -> None:
    mesh = rocky_client.ground_truth_mesh()
    inner = mesh.vertices_m[np.abs(mesh.vertices_m[:, :2]).max(axis=1) < 11.9]
    heights = rocky_client.query_height(inner)
    assert mesh.triangles.max() < len(mesh.vertices_m)
    assert mesh.semantic_ids is not None
    assert len(mesh.semantic_ids) == len(mesh.triangles)
    # Only a ray that grazes a vertex of a rock's outline may miss it.
    assert np.mean(heights.clearance_m < 1e-4) > 0.99
    # More than half of the vertices are of rocks, whose lower part is in the ground.
    assert np.quantile(np.abs(heights.clearance_m), 0.4) < 1e-4


@pytest.mark.long
def test_large_images_pass_the_default_limits(start_server: StartServer) -> None:
    camera = {"width_px": 1600, "height_px": 1200, "fx_px": 1350.0, "fy_px": 1350.0}
    world = {**FLAT_WORLD, "sensors": {"cameras": [camera]}}
    with start_server(world).client() as client:
        client.step_batch()
        sample = client.render_sample(NADIR, modalities=["depth"])
    depth_m = sample.frame("camera", "depth").data
    assert depth_m.nbytes > 4 * 1024 * 1024
    np.testing.assert_allclose(depth_m, np.full((1200, 1600), 7.0), rtol=1e-5)


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        (ModuleMetadata(sensor={"pose": Pose((np.nan, 0, 5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(sensor={"pose": Pose((0, np.inf, 5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(sensor={"pose": Pose((0, 0, 5), (0, 0, 0, 0))}), "pose.orientation"),
        (ModuleMetadata(sensor={"pose": Pose((0, 0, 5), (0, 0, 0.2, 1))}), "pose.orientation"),
        (ModuleMetadata(sensor={"pose": Pose((0, 0, -5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(sensor={"pose": Pose((90, 0, 5), (0, 0, 0, 1))}), "pose.position"),
        (ModuleMetadata(environment={"sun": 3}), "metadata.environment"),
        (ModuleMetadata(environment={"sun_elevation_deg": 300}), "metadata.environment"),
        (ModuleMetadata(custom={"weather": {"rain": 1}}), "metadata.custom.weather"),
    ],
)
def test_what_is_refused_changes_nothing(
    flat_client: SimulatorClient, metadata: ModuleMetadata, field: str
) -> None:
    before, kept = flat_client.render_sample(NADIR), flat_client.info()
    with pytest.raises(InvalidInputError) as refused:
        flat_client.render_sample(metadata=metadata)
    assert field in refused.value.field
    assert refused.value.expected
    assert code_of(refused.value) == grpc.StatusCode.INVALID_ARGUMENT
    info = flat_client.info()
    assert (info.batch_id, info.sample_id) == (kept.batch_id, kept.sample_id)
    after = flat_client.render_sample()
    assert after.rig_pose == before.rig_pose
    for a, b in zip(before.frames, after.frames, strict=True):
        assert np.array_equal(a.data, b.data)


def test_other_refusals_name_their_field(flat_client: SimulatorClient) -> None:
    with pytest.raises(InvalidInputError) as refused:
        flat_client.render_sample(modalities=["smell"])
    assert (refused.value.field, refused.value.received) == ("modalities", "smell")
    no_colour = ModuleMetadata(render={"quality": "geometry"})
    with pytest.raises(InvalidInputError) as refused:
        flat_client.render_sample(metadata=no_colour, modalities=["rgb"])
    assert (refused.value.field, refused.value.received) == ("modalities", "rgb")
    with pytest.raises(InvalidInputError) as refused:
        flat_client.step_batch(seed=-1)
    assert (refused.value.field, refused.value.received) == ("seed", -1)
    with pytest.raises(InvalidInputError, match="points_m"):
        flat_client.query_height([[0.0, np.nan, 0.0]])
    with pytest.raises(NotFoundError):
        flat_client.get_sample(77, 1)
    with pytest.raises(NotFoundError):
        flat_client.get_operation("operations/999999")


def test_the_service_describes_itself(flat_server: Server) -> None:
    with grpc.insecure_channel(flat_server.address) as channel:
        services = ProtoReflectionDescriptorDatabase(channel).get_services()
    assert {"oaisys.v1.SimulatorService", "grpc.health.v1.Health"} <= set(services)


def test_bytes_that_are_no_grpc_do_no_harm(flat_server: Server) -> None:
    host, port = flat_server.address.split(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\n\r\n" + bytes(range(256)) * 64)
    with flat_server.client() as client:
        client.wait_ready(PATIENCE_S)
        assert client.info().backend == "analytic"


def test_height_fields_come_in_chunks_and_are_what_queries_say(
    rocky_client: SimulatorClient,
) -> None:
    client = rocky_client
    x0, y0, x1, _ = client.info().stage_extent_m or (0, 0, 0, 0)
    resolution_m = (x1 - x0) / 520  # more than one chunk of 1 MiB
    grid = client.height_grid(resolution_m)
    assert grid.ground_m.nbytes > 1 << 20
    rows, columns = grid.ground_m.shape
    drawn = np.random.default_rng(3).integers((rows, columns), size=(500, 2))
    on_rocks = np.argwhere(grid.surface_m > grid.ground_m)[::50]
    assert len(on_rocks) > 5
    row, column = np.concatenate((drawn, on_rocks)).T
    x = grid.origin_xy_m[0] + grid.spacing_m * column
    y = grid.origin_xy_m[1] + grid.spacing_m * row
    asked = client.query_height(np.column_stack((x, y, np.zeros(len(x)))))
    np.testing.assert_array_equal(grid.ground_m[row, column], np.float32(asked.ground_height_m))
    top_m = np.float32(asked.surface_height_m)
    np.testing.assert_array_equal(grid.surface_m[row, column], top_m)
    part = client.height_grid(0.5, (x0 - 1, y0 - 1, x0 + 1, y0 + 1))
    assert np.isnan(part.ground_m).sum() == 12
    for resolution_m in (1e-6, 0.0, float("nan"), 5e-324):
        with pytest.raises(InvalidInputError, match="resolution_m"):
            client.height_grid(resolution_m)
    with pytest.raises(InvalidInputError, match="extent_m"):
        client.height_grid(1.0, (0, 0, 0, 0))


def test_the_heights_of_a_server_are_written_by_the_command(
    flat_server: Server, flat_client: SimulatorClient, tmp_path: Path
) -> None:
    out, address = tmp_path / "heights.npz", flat_server.address
    done = oaisys_here("heights", "--address", address, "--out", out, "--resolution", 0.5)
    assert done.returncode == 0, done.stderr
    grid = flat_client.height_grid(0.5)
    with np.load(out) as found:
        np.testing.assert_array_equal(found["ground_m"], grid.ground_m)
        assert tuple(found["origin_xy_m"]) == grid.origin_xy_m
