"""A data set's worlds in a plain loop: the times of its views, of encoding, and its memory."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

# Must come before anything that loads Open3D, see oaisys_core.private.open3d_import.
import bpy  # noqa: F401

from oaisys_core.errors import RenderError
from oaisys_core.procedural.textures.cache import LIMIT_VARIABLE
from oaisys_core.types import Sample
from oaisys_dataset.manifest import WorldFailure
from oaisys_dataset.rendering.world_render import WorldRenderer
from oaisys_dataset.shards import encode_pixels
from tools.bench.jobs.world import simulation_of
from tools.bench.machine import memory_mb
from tools.bench.settings import Say, Settings, camera
from tools.bench.worlds.dataset import VIEWS_AHEAD, dataset_config, dataset_tasks

ENCODED_VIEWS = 5

SMALL_PX = (64, 48)
SMALL_STAGE: dict[str, Any] = {"stage": {"resolution_px": 257}}


def loop(
    settings: Settings, say: Say, world: str, quality: str, worlds: int, views: int
) -> dict[str, Any]:
    """Return the times of worlds and of their views, which are rendered and thrown away.

    Returns:
        ``batch_s`` by world, ``sample_s`` by world and view; ``cpu_s``, the processor time after
        the first world's first `VIEWS_AHEAD` views; ``encode_cpu_s`` by modality, for each of some
        views.
    """
    # Textures would come from the disk in whichever of two runs is the second.
    os.environ[LIMIT_VARIABLE] = "0"
    config = dataset_config(settings, world, quality)
    batch_s: list[float] = []
    sample_s: list[list[float]] = []
    samples: list[Sample] = []
    cpu_ahead_s: float | None = None
    with simulation_of(config) as simulation:
        for task in dataset_tasks(config, worlds, views):
            say(task.index / worlds, f"{quality}, a plain loop, world {task.index + 1}")
            simulation.restore({"last_batch_id": task.index, "batch": None})
            began_s = time.perf_counter()
            simulation.step_batch(seed=task.seed)
            batch_s.append(time.perf_counter() - began_s)
            sample_s.append([])
            for _ in range(views):
                began_s = time.perf_counter()
                samples = [*samples[1 - ENCODED_VIEWS :], simulation.step_sample()]
                sample_s[-1].append(time.perf_counter() - began_s)
                if cpu_ahead_s is None and len(sample_s[0]) == VIEWS_AHEAD:
                    cpu_ahead_s = time.process_time()
        assert cpu_ahead_s is not None
        cpu_s = time.process_time() - cpu_ahead_s
    encode_cpu_s = _encoding_cpu_s(samples)
    return {
        "batch_s": batch_s,
        "sample_s": sample_s,
        "cpu_s": cpu_s,
        "encode_cpu_s": encode_cpu_s,
    }


def _encoding_cpu_s(samples: Sequence[Sample]) -> dict[str, list[float]]:
    """Return the processor time of encoding the images of samples, by modality."""
    found: dict[str, list[float]] = {}
    for sample in samples:
        for frame in sample.frames:
            began_s = time.process_time()
            encode_pixels(frame.data)
            found.setdefault(frame.modality, []).append(time.process_time() - began_s)
    return found


def worker_memory(settings: Settings, say: Say, worlds: int) -> list[float]:
    """Return the memory in MB after each of many small worlds that one renderer makes.

    Raises:
        RenderError: A world cannot be made.
    """
    changes = {**SMALL_STAGE, **camera(*SMALL_PX)}
    config = dataset_config(settings, "demo", "preview", changes)
    found_mb = []
    renderer = WorldRenderer(config, "bench")
    try:
        for task in dataset_tasks(config, worlds, views=1):
            say(task.index / worlds, f"{worlds} worlds, one after the other")
            for part in renderer.render(task):
                if isinstance(part, WorldFailure):
                    raise RenderError(f"world {task.index}: {part.reason}")
            found_mb.append(memory_mb())
    finally:
        renderer.close()
    return found_mb
