"""How long a finished sample takes from the worker to a client's arrays."""

from __future__ import annotations

import time
from typing import Any

from oaisys_core.errors import OaisysError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, merged
from oaisys_grpc.client import SimulatorClient
from tools.bench.jobs.memory import peak_memory_mb
from tools.bench.jobs.processes import SERVER, SMALL_WORLD, WORKER, camera, child, server
from tools.bench.settings import Say, Settings

MODALITIES = (RGB, DEPTH, SEMANTIC_0, INSTANCE)
WARM_UP = 3


def samples(
    settings: Settings, say: Say, size_px: tuple[int, int], *, shared_memory: bool, count: int
) -> dict[str, Any]:
    """Return milliseconds of samples of one size, and the processes' peak memory in MB.

    The worker answers from its cache of views, so that nothing is rendered meanwhile; what it
    says that it took even so is not counted as transfer.
    """
    world = merged(SMALL_WORLD, camera(*size_px))
    whole_ms, stored_ms, render_ms, bytes_sent = [], [], [], 0
    with (
        server(settings, world, "--pose-cache-mb", "512") as address,
        SimulatorClient(address, shared_memory=shared_memory) as client,
    ):
        client.step_batch()
        pose = pose_looking_down(0.0, 0.0, 12.0)
        client.render_sample(pose, modalities=MODALITIES)
        for index in range(-WARM_UP, count):
            say((index + WARM_UP) / (count + WARM_UP), f"{size_px[0]}x{size_px[1]}")
            started_s = time.perf_counter()
            sample = client.render_sample(pose, modalities=MODALITIES)
            rendered_s = time.perf_counter()
            again = client.get_sample(sample.batch_id, sample.sample_id)
            stored_s = time.perf_counter()
            if not sample.from_cache or len(again.frames) != len(MODALITIES):
                raise OaisysError(f"sample {sample.sample_id} was rendered, not found in the cache")
            if index < 0:
                continue
            render_ms.append(1e3 * sample.render_time_s)
            whole_ms.append(1e3 * (rendered_s - started_s))
            stored_ms.append(1e3 * (stored_s - rendered_s))
            bytes_sent = sum(frame.data.nbytes for frame in sample.frames)
        memory = {
            name: peak_memory_mb(str(child(text).pid))
            for name, text in (("worker", WORKER), ("server", SERVER))
        }
    return {
        "transfer_ms": [a - b for a, b in zip(whole_ms, render_ms, strict=True)],
        "call_ms": whole_ms,
        "stored_ms": stored_ms,
        "memory": {**memory, "client": peak_memory_mb()},
        "megabytes": bytes_sent / 1e6,
    }
