"""Times of a finished sample from the worker to a client's arrays."""

from __future__ import annotations

import time
from collections import defaultdict
from typing import Any

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, Pose, merge
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_grpc.memory import keep_freed_memory
from tools.bench.jobs.transport.processes import SERVER, SMALL_WORLD, WORKER, child, server
from tools.bench.machine import peak_memory_mb
from tools.bench.settings import Say, Settings, camera

MODALITIES = (RGB, DEPTH, SEMANTIC_0, INSTANCE)
WARM_UP = 3
CACHE_MB = 512
STEP_M = 0.01
"""Motion of the camera between views that are rendered."""


def samples(
    settings: Settings,
    say: Say,
    size_px: tuple[int, int],
    *,
    shared_memory: bool,
    cached: bool,
    count: int,
) -> dict[str, Any]:
    """Return milliseconds of samples of one size, and the processes' peak memory in MB.

    Args:
        settings: Of the run.
        say: Called with the progress.
        size_px: Of the images.
        shared_memory: Whether images come by shared memory; otherwise through the connection.
        cached: Whether the worker takes all four images from its cache of views. Otherwise each
            view is rendered, and depth and labels are sent before colour.
        count: Number of samples.

    Returns:
        ``transfer_ms``: from the worker's last image until the client has all of them.
        ``overhead_ms``: the whole call without the worker's rendering. ``call_ms``: the whole
        call. ``stored_ms``: `GetSample` of the same sample.
    """
    keep_freed_memory()
    world = merge(SMALL_WORLD, camera(*size_px))
    found: defaultdict[str, list[float]] = defaultdict(list)
    with (
        server(settings, world, "--pose-cache-mb", str(CACHE_MB if cached else 0)) as address,
        SimulatorClient(address, shared_memory=shared_memory) as client,
    ):
        client.step_batch()
        client.render_sample(pose_looking_down(0.0, 0.0, 12.0), modalities=MODALITIES)
        for index in range(-WARM_UP, count):
            say((index + WARM_UP) / (count + WARM_UP), f"{size_px[0]}x{size_px[1]}")
            pose = pose_looking_down(0.0, 0.0, 12.0 if cached else 12.0 + STEP_M * (1 + index))
            times = _one(client, pose, cached)
            if index >= 0:
                for name, milliseconds in times.items():
                    found[name].append(milliseconds)
        sample = client.render_sample(pose, modalities=MODALITIES)
        bytes_sent = sum(frame.data.nbytes for frame in sample.frames)
        memory = _peak_memory_mb()
    return {**found, "memory": memory, "megabytes": bytes_sent / 1e6}


def _peak_memory_mb() -> dict[str, float]:
    """Return the peak memory of worker, server and client, which is this process."""
    children = {"worker": WORKER, "server": SERVER}
    peaks = {name: peak_memory_mb(str(child(text).pid)) for name, text in children.items()}
    return {**peaks, "client": peak_memory_mb()}


def _one(client: SimulatorClient, pose: Pose, cached: bool) -> dict[str, float]:
    """Return the milliseconds of one sample."""
    begun_ns = time.monotonic_ns()
    sample = client.render_sample(pose, modalities=MODALITIES)
    rendered_ns = time.monotonic_ns()
    again = client.get_sample(sample.batch_id, sample.sample_id)
    stored_ns = time.monotonic_ns()
    if sample.from_cache is not cached or not len(sample.frames) == len(again.frames) == 4:
        raise OaisysError(
            f"sample {sample.sample_id}: from_cache {sample.from_cache}, not {cached}"
        )
    call_ms = 1e-6 * (rendered_ns - begun_ns)
    return {
        "transfer_ms": 1e-6 * (rendered_ns - sample.finished_ns),
        "overhead_ms": call_ms - 1e3 * sample.render_time_s,
        "call_ms": call_ms,
        "stored_ms": 1e-6 * (stored_ns - rendered_ns),
    }
