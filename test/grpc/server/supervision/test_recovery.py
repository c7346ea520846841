"""What the service promises when a worker or a server dies, hangs or crashes again and again."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import grpc
import psutil
import pytest
from attacks import OURS, own_channel
from served_simulator import FLAT_WORLD, Server, code_of
from waiting import PATIENCE_S, SHUTDOWN_S, wait_until, within

from oaisys_core.errors import DeadlineExceededError, OaisysError, WorkerLostError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import ModuleMetadata, Progress, Sample
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.contract.faults import ServerUnavailableError
from oaisys_grpc.server.supervision import worker_limits
from oaisys_grpc.server.supervision.worker_limits import CANCEL_IDLE_S, CallLimit, ProcessorTime
from oaisys_grpc.server.supervision.worker_log import WorkerLog
from oaisys_grpc.server.supervision.worker_process import FOLDER_PREFIX, WorkerProcess
from oaisys_grpc.worker.protocol import WorkerMessage

StartServer = Callable[..., Server]
POSES = [pose_looking_down(1, 1, 11, 0.4), pose_looking_at((-6, -5, 7), (2, 3, 0))]
TEST_BUILD = {"OAISYS_TEST_BUILD": "1"}


def render_until(client: SimulatorClient, begun: threading.Event) -> Sample:
    """Render a slow sample; set ``begun`` once the worker is at it."""

    def listen(progress: Progress) -> None:
        if progress.stage == "fault":
            begun.set()

    return client.render_sample(POSES[1], on_progress=listen)


@pytest.mark.long
def test_a_worker_killed_while_idle_is_replaced_unasked(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT="crash")  # for test builds only
    with server.client() as client:
        client.step_batch()
        lamps = {"left": {"frame": "base_link", "position_m": [0, 0, 1], "strength_w": 900}}
        dark = client.render_sample(POSES[0])
        lit = ModuleMetadata(environment={"lamps": lamps})
        before = client.render_sample(metadata=lit)
        worker = server.worker()
        worker.kill()
        wait_until(lambda: not worker.is_running() and server.worker().pid != worker.pid)
        client.wait_ready(PATIENCE_S)
        after = client.render_sample()
    images = [[f.data.tobytes() for f in sample.frames] for sample in (dark, before, after)]
    assert images[0] != images[1] == images[2]
    assert after.sample_id == before.sample_id + 1


def test_a_killed_server_takes_its_worker_along(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
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
    "signals",
    [
        pytest.param([signal.SIGTERM, signal.SIGINT], marks=pytest.mark.long),
        pytest.param([signal.SIGINT], marks=pytest.mark.soak),
        pytest.param([signal.SIGHUP] * 2, marks=pytest.mark.soak),
        pytest.param([signal.SIGQUIT], marks=pytest.mark.soak),
    ],
)
def test_signals_end_everything_quietly_even_while_it_renders(
    start_server: StartServer, signals: list[signal.Signals]
) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT=f"slow:{2 * PATIENCE_S}", **TEST_BUILD)
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


@pytest.mark.long
def test_a_render_that_is_nearly_done_may_end_after_a_signal(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT="slow:0.3", **TEST_BUILD)
    with server.client() as client, ThreadPoolExecutor() as pool:
        client.step_batch()
        # A worker's first sample may take longer than an ending server waits.
        client.render_sample(POSES[0])
        begun = threading.Event()
        rendering = pool.submit(render_until, client, begun)
        assert begun.wait(PATIENCE_S)
        with within(SHUTDOWN_S):
            server.process.send_signal(signal.SIGTERM)
            assert rendering.result(PATIENCE_S).sample_id == 2
            assert server.process.wait(PATIENCE_S) == 0


def test_a_signal_while_the_worker_starts_ends_quietly(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD)
    worker = server.worker()
    with within(SHUTDOWN_S):
        for _ in range(2):  # SIGHUP left the worker's folder behind
            server.process.send_signal(signal.SIGHUP)
        assert server.process.wait(PATIENCE_S) == 0
    assert not worker.is_running()
    assert "Traceback" not in server.stderr.read_text()


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--worker-python", "/bin/false"], 1, "exited with 1"),
        (["--worker-python", "/nowhere/python"], 1, "cannot start"),
        (["--backend", "paper"], 2, "paper"),
    ],
)
def test_what_cannot_be_served_is_refused_with_one_line(
    start_server: StartServer, options: list[str], code: int, said: str
) -> None:
    server = start_server(FLAT_WORLD, *options)
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
    limit = CallLimit(PATIENCE_S, PATIENCE_S, threading.Event())
    with pytest.raises(WorkerLostError, match=r"exited with 3; it said last: no disk is left"):
        next(worker.call("start", WorkerMessage({}), limit))


def test_a_shutdown_blames_nobody_for_the_worker_that_it_kills(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT=f"batch-slow:{PATIENCE_S}", **TEST_BUILD)
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


@pytest.mark.long
def test_what_a_killed_server_left_is_gone_after_the_next_start(
    start_server: StartServer, tmp_path: Path
) -> None:
    """Another server's folder stays, and so does what is no server's at all."""
    shared = tmp_path / "shared"
    (shared / f"{FOLDER_PREFIX}not-ours").mkdir(parents=True)
    (shared / f"{FOLDER_PREFIX}link").symlink_to(tmp_path)
    others = set(shared.iterdir())
    killed = start_server(FLAT_WORLD, TMPDIR=str(shared))
    with killed.client() as client:
        client.wait_ready(PATIENCE_S)
    (left,) = set(shared.iterdir()) - others
    living = start_server(FLAT_WORLD, TMPDIR=str(shared))
    with living.client() as client:
        client.wait_ready(PATIENCE_S)
    (kept,) = set(shared.iterdir()) - others - {left}
    killed.process.kill()
    killed.process.wait()
    assert left.exists()
    third = start_server(FLAT_WORLD, TMPDIR=str(shared))
    with third.client() as client:
        client.wait_ready(PATIENCE_S)
    assert not left.exists()
    assert kept.exists()
    living.end()
    third.end()
    assert set(shared.iterdir()) == others
    assert tmp_path.exists()


SPIN = """
import os, sys
os.nice(int(sys.argv[1]))
os.sched_setaffinity(0, {%d})
print("computing", flush=True)
while True: pass
"""


@contextlib.contextmanager
def spinning(nice: int, count: int = 1) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that compute, all on one processor."""
    command = [sys.executable, "-c", SPIN % min(os.sched_getaffinity(0)), str(nice)]
    with contextlib.ExitStack() as stack:
        processes = []
        for _ in range(count):
            process = subprocess.Popen(command, stdout=subprocess.PIPE)
            processes.append(stack.enter_context(process))
            stack.callback(process.kill)
        for process in processes:
            assert process.stdout is not None
            assert process.stdout.readline() == b"computing\n"
        yield processes


@pytest.mark.long
def test_a_cancelled_worker_is_judged_by_its_work_not_by_the_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work_s = 1.0
    monkeypatch.setattr(worker_limits, "CANCEL_WORK_S", work_s)
    cancelled = threading.Event()
    cancelled.set()
    limit = CallLimit(PATIENCE_S, 0.0, cancelled, worth_a_worker=True)
    patient = CallLimit(PATIENCE_S, 0.0, cancelled)
    with spinning(5) as (worker,):
        wait_until(lambda: ProcessorTime(worker.pid).look()[0] >= 0)
        with spinning(0, count=4):
            effort = ProcessorTime(worker.pid)
            end_s = time.monotonic() + 3 * work_s
            while time.monotonic() < end_s:
                assert not limit.must_kill(effort)
                time.sleep(0.05)
        wait_until(lambda: limit.must_kill(effort))
        worked_s, idle_s = effort.look()
        assert worked_s >= work_s
        assert idle_s < CANCEL_IDLE_S
        worker.send_signal(signal.SIGSTOP)
        hung = ProcessorTime(worker.pid)
        begin_s = time.monotonic()
        assert not limit.must_kill(hung)
        wait_until(lambda: limit.must_kill(hung))
        assert time.monotonic() - begin_s >= CANCEL_IDLE_S
        assert hung.look()[0] < work_s
        assert not patient.must_kill(hung)


@pytest.mark.long
def test_a_question_whose_caller_is_gone_leaves_no_traceback(start_server: StartServer) -> None:
    server = start_server(FLAT_WORLD, OAISYS_FAULT="slow:3", **TEST_BUILD)
    with (
        server.client() as client,
        SimulatorClient(server.address, timeout_s=0.2) as hasty,
        own_channel(server.address) as channel,
    ):
        client.step_batch()
        with ThreadPoolExecutor() as pool:
            begun = threading.Event()
            sample = pool.submit(render_until, client, begun)
            begun.wait(PATIENCE_S)
            for _ in range(4):
                with pytest.raises(DeadlineExceededError):
                    hasty.query_height([[0, 0, 5]])
                asked = channel.unary_unary(f"{OURS}QueryHeight").future(b"", timeout=PATIENCE_S)
                mesh = channel.unary_stream(f"{OURS}GetGroundTruthMesh")(b"", timeout=PATIENCE_S)
                client.info()  # it comes after them
                asked.cancel()
                mesh.cancel()
            sample.result(PATIENCE_S)
        assert client.query_height([[0, 0, 5]]).clearance_m.shape == (1,)
    server.end()
    assert "Traceback" not in server.stderr.read_text()
