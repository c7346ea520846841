"""What the service promises when a worker or a server dies, hangs or crashes again and again."""

import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import psutil
import pytest
from served_simulator import PATIENCE_S, ROCKY_WORLD, Server, wait_until

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import (
    BackendUnavailableError,
    DeadlineExceededError,
    OaisysError,
    WorkerLostError,
)
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata, Progress, Sample
from oaisys_grpc.client import SimulatorClient
from oaisys_grpc.faults import ServerUnavailableError

StartServer = Callable[..., Server]
POSES = [pose_looking_down(1, 1, 11, 0.4), pose_looking_at((-6, -5, 7), (2, 3, 0))]
TEST_BUILD = {"OAISYS_TEST_BUILD": "1"}


def labels_of(sample: Sample) -> list[bytes]:
    return [f.data.tobytes() for f in sample.frames if f.modality != "rgb"]


def render_until(client: SimulatorClient, begun: threading.Event) -> Sample:
    """Render a slow sample; set ``begun`` once the worker is at it."""

    def listen(progress: Progress) -> None:
        if progress.stage == "fault":
            begun.set()

    return client.render_sample(POSES[1], on_progress=listen)


def test_a_killed_worker_is_replaced_and_goes_on_as_if_nothing_had_happened(
    start_server: StartServer,
) -> None:
    control = Simulation(config_from_mapping(ROCKY_WORLD))
    control.step_batch()
    control.step_batch(reuse_stage=True)
    control.step_sample(ModuleMetadata(sensor={"pose": POSES[0]}))
    expected = control.step_sample(ModuleMetadata(sensor={"pose": POSES[1]}))
    server = start_server(ROCKY_WORLD, OAISYS_FAULT="slow:0.3", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        client.step_batch(reuse_stage=True)
        client.render_sample(POSES[0])
        begun = threading.Event()
        killed = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        worker = server.worker()
        worker.send_signal(signal.SIGKILL)
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            killed.result(PATIENCE_S)
        client.wait_ready(PATIENCE_S)
        sample = client.render_sample(POSES[1])
    assert server.worker().pid != worker.pid
    assert (sample.batch_id, sample.sample_id) == (expected.batch_id, expected.sample_id) == (2, 2)
    assert sample.rig_pose == expected.rig_pose
    assert sample.provenance == expected.provenance
    assert labels_of(sample) == labels_of(expected)


def test_a_worker_killed_while_idle_is_replaced_unasked(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    with server.client() as client:
        client.step_batch()
        before = client.render_sample(POSES[0])
        worker = server.worker()
        worker.kill()
        wait_until(lambda: not worker.is_running() and server.worker().pid != worker.pid)
        client.wait_ready(PATIENCE_S)
        after = client.render_sample()
    assert labels_of(before) == labels_of(after)
    assert after.sample_id == before.sample_id + 1


def test_a_worker_that_hangs_is_killed_and_health_answers_meanwhile(
    start_server: StartServer,
) -> None:
    server = start_server(ROCKY_WORLD, "--grace", "0.5", OAISYS_FAULT="hang", **TEST_BUILD)
    with server.client() as client, SimulatorClient(server.address, timeout_s=1.0) as hasty:
        client.step_batch()
        worker = server.worker()
        with pytest.raises(DeadlineExceededError):
            hasty.render_sample(POSES[0])
        assert client.is_ready(PATIENCE_S) or not worker.is_running()
        psutil.wait_procs([worker], PATIENCE_S)
        assert not worker.is_running()
        client.wait_ready(PATIENCE_S)
        assert client.info().batch_id == 1
        assert np.isfinite(client.query_height([[0, 0, 5]]).clearance_m).all()


def test_after_crash_upon_crash_it_says_so_and_stops_trying(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT="crash", **TEST_BUILD)
    with server.client() as client:
        client.step_batch()
        for _ in range(3):
            with pytest.raises(WorkerLostError, match="SIGABRT"):
                client.render_sample(POSES[0])
        with pytest.raises(BackendUnavailableError, match="SIGABRT") as refused:
            client.render_sample(POSES[0])
        assert "FAILED_PRECONDITION" in str(refused.value.__cause__)
        assert not client.is_ready(PATIENCE_S)
    assert not psutil.Process(server.process.pid).children()


def test_faults_strike_in_test_builds_only(start_server: StartServer) -> None:
    with start_server(ROCKY_WORLD, OAISYS_FAULT="crash").client() as client:
        client.step_batch()
        assert client.render_sample(POSES[0]).sample_id == 1


def test_a_killed_server_takes_its_worker_along(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    worker = server.worker()
    with server.client() as client:
        client.step_batch()
        server.process.kill()
        server.process.wait()
        _, alive = psutil.wait_procs([worker], PATIENCE_S)
        assert not alive
        with pytest.raises(ServerUnavailableError):
            client.info()


@pytest.mark.parametrize("signals", [[signal.SIGTERM], [signal.SIGINT] * 2])
def test_a_signal_ends_everything_quietly_even_while_it_renders(
    start_server: StartServer, signals: list[signal.Signals]
) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT="slow:30", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        worker = server.worker()
        begun = threading.Event()
        rendering = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        for number in signals:
            server.process.send_signal(number)
        assert server.process.wait(5.0) == 0
        with pytest.raises(OaisysError):
            rendering.result(PATIENCE_S)
    assert not worker.is_running()
    assert "Traceback" not in server.stderr.read_text()
    assert server.stdout.read_text().count("\n") == 1


def test_a_signal_while_the_worker_starts_ends_quietly(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    worker = server.worker()
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(PATIENCE_S) == 0
    assert not worker.is_running()
    assert "Traceback" not in server.stderr.read_text()


def test_end_simulation_ends_everything(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    worker = server.worker()
    with server.client() as client:
        client.step_batch()
        client.end_simulation()
    assert server.process.wait(PATIENCE_S) == 0
    assert not worker.is_running()


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--address", "0.0.0.0:0"], 2, "--insecure"),
        (["--worker-python", "/bin/false"], 1, "exited with 1"),
        (["--worker-python", "/nowhere/python"], 1, "cannot start"),
        (["--backend", "paper"], 2, "paper"),
    ],
)
def test_what_cannot_be_served_is_refused_with_one_line(
    start_server: StartServer, options: list[str], code: int, said: str
) -> None:
    server = start_server(ROCKY_WORLD, *options)
    assert server.process.wait(PATIENCE_S) == code
    assert said in server.stderr.read_text()
    assert "Traceback" not in server.stderr.read_text()
    assert server.stdout.read_text() == ""


@pytest.mark.blender
def test_a_killed_blender_is_replaced_and_renders_the_same(start_server: StartServer) -> None:
    camera = {"width_px": 32, "height_px": 24, "fx_px": 27.0, "fy_px": 27.0}
    world = {**ROCKY_WORLD, "backend": "blender", "sensors": {"cameras": [camera]}}
    server = start_server(world, OAISYS_FAULT="slow:0.5", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        client.render_sample(POSES[0], modalities=["depth"])
        begun = threading.Event()
        killed = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        server.worker().kill()
        with pytest.raises(WorkerLostError, match="SIGKILL"):
            killed.result(PATIENCE_S)
        sample = client.render_sample(POSES[1])
        client.step_batch(seed=sample.provenance.batch_seed)
        control = client.render_sample(POSES[1])
    assert sample.sample_id == 2
    assert labels_of(sample) == labels_of(control)
    assert (sample.frame("camera", "depth").data > 1).all()
    rgb, control_rgb = (s.frame("camera", "rgb").data.astype(int) for s in (sample, control))
    assert rgb.std() > 1
    assert np.abs(rgb - control_rgb).max() <= 2
