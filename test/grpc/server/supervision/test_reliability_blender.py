"""Rows 1, 2, 5 and 8 of docs/reliability.md with Blender at 32x24, row 24 at 64x48."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import psutil
import pytest
from endurance import AROUND, config
from served_simulator import ROCKY_WORLD, Server
from waiting import PATIENCE_S

from oaisys_core.errors import WorkerLostError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import ModuleMetadata, Pose, Progress, Sample
from oaisys_grpc.client.simulator_client import SimulatorClient

pytestmark = pytest.mark.blender

WORLD: dict[str, Any] = {
    **ROCKY_WORLD,
    "backend": "blender",
    "sensors": {"cameras": [{"width_px": 32, "height_px": 24, "fx_px": 27.0, "fy_px": 27.0}]},
}
POSES = [
    pose_looking_down(1, 1, 11, 0.4),
    pose_looking_at((-6, -5, 7), (2, 3, 0)),
    pose_looking_down(-2, 0, 9, 1.1),
    pose_looking_at((5, -4, 6), (0, 1, 0)),
    pose_looking_at((3, 6, 8), (0, 0, 0)),
    pose_looking_down(4, 3, 10),
    pose_looking_down(0, -3, 8, 2.0),
]
ENDURANCE_SAMPLES = "OAISYS_ENDURANCE_SAMPLES"
"""500 for the whole of row 24, on a machine that does nothing else."""
SHORT_ENDURANCE = 60
LONG_RENDER = ModuleMetadata(render={"samples": 60_000})
"""Minutes within Cycles."""


def kill_within_cycles(server: Server, client: SimulatorClient, number: signal.Signals) -> None:
    """End the worker while Cycles renders `POSES[1]`; the caller is told."""
    begun = threading.Event()

    def listen(progress: Progress) -> None:
        if progress.stage == "color":
            begun.set()

    with ThreadPoolExecutor() as pool:
        rendering = pool.submit(
            client.render_sample, POSES[1], metadata=LONG_RENDER, on_progress=listen
        )
        assert begun.wait(PATIENCE_S)
        server.worker().send_signal(number)
        with pytest.raises(WorkerLostError, match=number.name):
            rendering.result(PATIENCE_S)


def cancel_within_cycles(client: SimulatorClient, pose: Pose) -> None:
    """Give up a render that would take minutes, and see that a worker is free again."""

    class EnoughError(Exception):
        pass

    def leave(progress: Progress) -> None:
        if progress.stage == "color":
            raise EnoughError

    with pytest.raises(EnoughError):
        client.render_sample(pose, metadata=LONG_RENDER, on_progress=leave)
    assert np.isfinite(client.query_height([[0, 0, 5]]).clearance_m).all()


def assert_alike(sample: Sample, control: Sample) -> None:
    assert (sample.batch_id, sample.sample_id) == (control.batch_id, control.sample_id)
    assert (sample.rig_pose, sample.provenance) == (control.rig_pose, control.provenance)
    for frame, other in zip(sample.frames, control.frames, strict=True):
        if frame.modality == "rgb":
            assert frame.data.std() > 1
            assert np.abs(frame.data.astype(int) - other.data.astype(int)).max() <= 2
        else:
            np.testing.assert_array_equal(frame.data, other.data)


def renders_beside_cancelled_ones(server: Server) -> list[Sample]:
    """Return a sample of each of `POSES`; renders that are cancelled then change nothing.

    Also before Cycles has the world: in the second batch, the first render is cancelled.
    """
    with server.client() as client:
        client.step_batch(seed=1)
        worker = server.worker().pid
        control = [client.render_sample(pose) for pose in POSES]
        again = []
        for batch_id in (1, 2):
            if batch_id == 2:
                client.step_batch(seed=1)
            for pose in POSES[1:3]:
                cancel_within_cycles(client, pose)
                again.append(client.render_sample(POSES[0]))
        assert server.worker().pid == worker
        assert client.info().worker_restarts == 0
    count = len(POSES)
    found = [(each.batch_id, each.sample_id) for each in again]
    assert found == [(1, count + 1), (1, count + 2), (2, 1), (2, 2)]
    for sample in again:
        for frame, other in zip(sample.frames, control[0].frames, strict=True):
            np.testing.assert_array_equal(frame.data, other.data)
    return control


@pytest.mark.long
def test_a_blender_that_is_cancelled_killed_crashes_or_grows_renders_the_same(
    start_server: Callable[..., Server],
) -> None:
    """It is replaced, unless it is cancelled."""
    with start_server(WORLD, "--pose-cache-mb", "0") as undisturbed:
        control = renders_beside_cancelled_ones(undisturbed)
    leak = {"OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": "leak:1300@3"}
    server = start_server(WORLD, "--worker-memory-limit-mb", "1600", **leak)
    with server.client() as client:
        client.step_batch(seed=1)
        samples = [client.render_sample(POSES[0])]
        for number in (signal.SIGKILL, signal.SIGSEGV):
            kill_within_cycles(server, client, number)
            samples.append(client.render_sample(POSES[len(samples)]))
        worker = server.worker().pid
        samples += [client.render_sample(pose) for pose in POSES[3:5]]
        # The worker has leaked in its third sample: another one renders the next.
        samples.append(client.render_sample(POSES[5]))
        assert server.worker().pid != worker
        assert client.info().worker_restarts == 2
        cancel_within_cycles(client, POSES[1])
        samples.append(client.render_sample(POSES[6]))
    for sample, expected in zip(samples, control, strict=True):
        assert_alike(sample, expected)


def cpu_s(process: psutil.Process) -> float:
    return float(sum(process.cpu_times()[:2]))


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_one_worker_s_memory_and_work_stay_flat_over_many_samples(
    start_server: Callable[..., Server],
) -> None:
    """CPU time is compared, which other processes lengthen less than the clock's."""
    given = os.environ.get(ENDURANCE_SAMPLES)
    count = int(given or SHORT_ENDURANCE)
    tenth = count // 10
    server = start_server(config("blender"), "--pose-cache-mb", "0")
    resident_mb, work_s = [], []
    with server.client() as client:
        client.step_batch()
        worker = server.worker()
        for pose in AROUND:
            last_id = client.render_sample(pose).sample_id
        files = worker.num_fds()
        for index in range(1, count + 1):
            began_s = cpu_s(worker)
            edits = {"objects": {"1": {"hidden": index % 2 == 1}}}
            sample = client.render_sample(metadata=ModuleMetadata(asset=edits))
            assert sample.sample_id == last_id + index
            work_s.append(cpu_s(worker) - began_s)
            resident_mb.append(worker.memory_info().rss / 1e6)
        assert server.worker().pid == worker.pid
        assert client.info().worker_restarts == 0
        assert worker.num_fds() <= files + 2
    # Of 500 samples these are 50 to 150, and the last 100.
    early, late = slice(tenth, 3 * tenth), slice(count - 2 * tenth, count)
    assert np.mean(resident_mb[late]) == pytest.approx(np.mean(resident_mb[early]), rel=0.1)
    most = 1.1 if given else 1.5
    assert np.median(work_s[late]) <= most * np.median(work_s[early])
