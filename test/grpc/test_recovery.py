"""What the service promises when a worker or a server dies, hangs or crashes again and again."""

import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import psutil
import pytest
from served_simulator import (
    PATIENCE_S,
    ROCKY_WORLD,
    SHUTDOWN_S,
    Server,
    code_of,
    wait_until,
    within,
)

from oaisys_core.errors import OaisysError, WorkerLostError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import Progress, Sample, ignore_progress
from oaisys_grpc.call_limit import Limit
from oaisys_grpc.client import SimulatorClient
from oaisys_grpc.faults import ServerUnavailableError
from oaisys_grpc.worker_log import WorkerLog
from oaisys_grpc.worker_process import WorkerProcess

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


@pytest.mark.parametrize(
    "signals", [[number] * count for number in (signal.SIGINT, signal.SIGTERM) for count in (1, 2)]
)
def test_signals_end_everything_quietly_even_while_it_renders(
    start_server: StartServer, signals: list[signal.Signals]
) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT=f"slow:{2 * PATIENCE_S}", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        worker = server.worker()
        begun = threading.Event()
        rendering = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        with within(SHUTDOWN_S):
            for number in signals:
                server.process.send_signal(number)
            assert server.process.wait(PATIENCE_S) == 0
        with pytest.raises(OaisysError) as ended:
            rendering.result(PATIENCE_S)
        assert code_of(ended.value) is grpc.StatusCode.UNAVAILABLE
    assert not worker.is_running()
    assert "Traceback" not in server.stderr.read_text()
    assert server.stdout.read_text().count("\n") == 1
    assert not list(server.stderr.parent.glob("oaisys-worker-*"))


def test_a_render_that_is_nearly_done_may_end_after_a_signal(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT="slow:0.3", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        begun = threading.Event()
        rendering = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        with within(SHUTDOWN_S):
            server.process.send_signal(signal.SIGTERM)
            assert rendering.result(PATIENCE_S).sample_id == 1
            assert server.process.wait(PATIENCE_S) == 0


def test_a_signal_while_the_worker_starts_ends_quietly(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    worker = server.worker()
    with within(SHUTDOWN_S):
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(PATIENCE_S) == 0
    assert not worker.is_running()
    assert "Traceback" not in server.stderr.read_text()


def test_end_simulation_ends_everything(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD)
    worker = server.worker()
    with server.client() as client:
        client.step_batch()
        with within(SHUTDOWN_S):
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


def test_how_a_worker_ended_is_not_hidden_by_our_own_signal(tmp_path: Path) -> None:
    """It closes its connection first, and only then comes to its end, as on a busy machine."""
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"#!{sys.executable}\n"
        "import os, sys, time\n"
        "os.close(int(sys.argv[sys.argv.index('--fd') + 1]))\n"
        "time.sleep(0.5)\n"
        "print('no disk is left', flush=True)\n"
        "os._exit(3)\n"
    )
    stand_in.chmod(0o755)
    worker = WorkerProcess(str(stand_in), WorkerLog())
    limit = Limit(PATIENCE_S, PATIENCE_S, threading.Event())
    with pytest.raises(WorkerLostError, match=r"exited with 3; it said last: no disk is left"):
        worker.call("start", {}, limit=limit, progress=ignore_progress)


def test_a_worker_that_its_server_kills_is_not_said_to_be_killed_by_others(
    start_server: StartServer,
) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT=f"slow:{2 * PATIENCE_S}", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        begun = threading.Event()
        rendering = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        server.worker().kill()
        with pytest.raises(OaisysError, match=r"was ended by SIGKILL \(sent by the system"):
            rendering.result(PATIENCE_S)
    server.end()
    assert "what workers print: " in server.stderr.read_text()


def test_a_shutdown_blames_nobody_for_the_worker_that_it_kills(start_server: StartServer) -> None:
    server = start_server(ROCKY_WORLD, OAISYS_FAULT=f"batch-slow:{PATIENCE_S}", **TEST_BUILD)
    begun = threading.Event()

    def listen(progress: Progress) -> None:
        if progress.stage == "fault":
            begun.set()

    with server.client() as client, ThreadPoolExecutor() as pool:
        building = pool.submit(client.step_batch, on_progress=listen)
        assert begun.wait(PATIENCE_S)
        with within(SHUTDOWN_S):
            server.process.send_signal(signal.SIGTERM)
            server.process.send_signal(signal.SIGTERM)
            assert server.process.wait(PATIENCE_S) == 0
        with pytest.raises(OaisysError):
            building.result(PATIENCE_S)
    assert "SIGKILL" not in server.stderr.read_text()
