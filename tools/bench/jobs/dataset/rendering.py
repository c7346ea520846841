"""A data set rendered on Ray as ``oaisys dataset render`` does, and a driver of many frames.

This process is the driver. It imports no Blender, so that its memory is that of a real one.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import psutil
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig
from oaisys_core.errors import RenderError
from oaisys_core.output.records import intrinsics_record
from oaisys_core.procedural.textures.cache import LIMIT_VARIABLE
from oaisys_core.types import DEPTH, INSTANCE, RGB, SEMANTIC_0, PinholeIntrinsics, Provenance
from oaisys_dataset import open_dataset
from oaisys_dataset.manifest import FrameRecord, WorldFailure, WorldLegend
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.records import frame_id
from oaisys_dataset.rendering import engine
from oaisys_dataset.rendering.dataset_rendering import DatasetRendering, dataset_info
from oaisys_dataset.rendering.engine import WorldFinished
from oaisys_dataset.rendering.ray_settings import RaySettings
from oaisys_dataset.rendering.workers import ViewCounts, WorldBegun, WorldPart
from oaisys_dataset.rendering.world_render import EncodedView
from oaisys_dataset.shards import encode_frame
from tools.bench.machine import memory_mb, peak_memory_mb
from tools.bench.settings import Say, Settings
from tools.bench.worlds.dataset import SPLITS, VIEWS_AHEAD, dataset_config

SIMULATED_CAMERA = PinholeIntrinsics(16, 12, 14.0, 14.0, 7.5, 5.5)
SIMULATED_MEMORY_GB = 0.5


def render_dataset(
    settings: Settings,
    say: Say,
    world: str,
    quality: str,
    worlds: int,
    views: int,
    workers: int,
) -> dict[str, Any]:
    """Render a data set into a temporary folder, and return what it took.

    Returns:
        ``start_s``, until the first worker began its first world: Ray, Blender and the simulation
        have started; ``s``, from then to the end of the last world; ``compared_s``, the part of it
        after `VIEWS_AHEAD` views, and ``cpu_s``, the processor time of all processes in that part;
        ``frames``; ``bytes``.
    """
    os.environ[LIMIT_VARIABLE] = "0"
    config = dataset_config(settings, world, quality)
    began_s = time.perf_counter()
    first_s = last_s = cpu_at_first_s = cpu_s = 0.0
    with tempfile.TemporaryDirectory(prefix="bench_dataset_") as folder:
        rendering = _rendering(config, folder, worlds, views)
        with rendering.begin(is_resumed=False):
            for event in rendering.run(RaySettings(workers=workers)):
                if isinstance(event, WorldFailure):
                    raise RenderError(f"{world}, world {event.world}: {event.reason}")
                if isinstance(event, ViewCounts):
                    if not first_s:
                        first_s, cpu_at_first_s = time.perf_counter(), _processor_s()
                    done = rendering.summary.views_done(views) / (worlds * views)
                    say(done, f"{quality}, {workers} workers, world {event.world + 1}")
                if isinstance(event, WorldFinished):
                    last_s, cpu_s = time.perf_counter(), _processor_s() - cpu_at_first_s
        ahead_s = sum(each.seconds for each in open_dataset(folder).records[:VIEWS_AHEAD])
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    start_s = first_s - ahead_s - began_s
    return {
        "start_s": start_s,
        "s": last_s - began_s - start_s,
        "compared_s": last_s - first_s,
        "cpu_s": cpu_s,
        "frames": rendering.summary.frames,
        "bytes": size,
    }


def driver_memory(settings: Settings, say: Say, worlds: int, views: int) -> dict[str, float]:
    """Return the memory in MB of a driver of many frames, whose workers only pretend to render.

    Returns:
        ``begun``, before the first frame; ``peak``, with all of them written; ``read``, when a
        reader in the same process has gone through all lines of the manifest.
    """
    config = dataset_config(settings, "demo", "geometry")
    begun_mb = memory_mb()
    with (
        tempfile.TemporaryDirectory(prefix="bench_dataset_") as folder,
        patch.object(engine, "render_world", simulate_world),
    ):
        rendering = _rendering(config, folder, worlds, views)
        with rendering.begin(is_resumed=False):
            settings_of_ray = RaySettings(workers=1, memory_gb=SIMULATED_MEMORY_GB)
            for event in rendering.run(settings_of_ray):
                if isinstance(event, WorldFailure):
                    raise RenderError(f"world {event.world}: {event.reason}")
                if isinstance(event, WorldFinished):
                    say(event.world / worlds, f"{worlds * views:,} lines of manifests")
        peak_mb = peak_memory_mb()
        lines = sum(1 for _ in open_dataset(folder).records)
    if lines != worlds * views:
        raise RenderError(f"{lines} lines were read, expected {worlds * views}")
    return {"begun": begun_mb, "peak": peak_mb, "read": peak_memory_mb()}


def simulate_world(config_json: str, task: WorldTask, url: str | None) -> Iterator[WorldPart]:
    """Yield the parts of a world with tiny images instead of rendering it."""
    del config_json, url
    yield WorldBegun(task.index)
    shape = SIMULATED_CAMERA.height_px, SIMULATED_CAMERA.width_px
    rng = np.random.default_rng(task.seed)
    arrays: dict[str, NDArray[Any]] = {
        RGB: rng.integers(0, 256, (*shape, 3)).astype(np.uint8),
        DEPTH: rng.uniform(1, 9, shape).astype(np.float32),
        SEMANTIC_0: rng.integers(1, 5, shape).astype(np.uint16),
        INSTANCE: rng.integers(0, 9, shape).astype(np.uint32),
    }
    encoded = encode_frame(_simulate_record(task, 0), arrays)
    for view in range(task.views):
        record = _simulate_record(task, view)
        images = {
            modality: replace(image, file=f"{record.frame_id}.{modality}{Path(image.file).suffix}")
            for modality, image in encoded.record.images.items()
        }
        labels = encoded.record.label_pixels
        whole = replace(record, images=images, label_pixels=labels)
        yield EncodedView(view, (encoded._replace(record=whole),))
    yield WorldLegend({number: f"label {number}" for number in range(1, 5)}, {})


def _simulate_record(task: WorldTask, view: int) -> FrameRecord:
    """Return a record as long as a real one."""
    sha256 = "0" * 64
    provenance = Provenance(task.seed, task.seed, sha256, "analytic", "0", "standard", 4)
    return FrameRecord(
        frame_id=frame_id(task.index, view, "camera"),
        world=task.index,
        view=view,
        sensor="camera",
        split=task.split,
        world_seed=task.seed,
        config_sha256=sha256,
        metadata={},
        T_map_camera=tuple(tuple(row) for row in np.eye(4).tolist()),
        intrinsics=intrinsics_record(SIMULATED_CAMERA),
        stamp_s=float(view),
        images={},
        provenance=asdict(replace(provenance, metadata_json="m" * 600)),
        rig_pose={"position_m": [0.0, 0.0, 1.0], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
        worker="bench:1",
        seconds=1.0,
        software={"python": "3"},
    )


def _rendering(config: SimulationConfig, folder: str, worlds: int, views: int) -> DatasetRendering:
    return DatasetRendering(open_place(folder), config, dataset_info(config, worlds, views, SPLITS))


def _processor_s() -> float:
    """Return the processor time that this process and all processes below it have had so far."""
    own = psutil.Process()
    total_s = 0.0
    for process in (own, *own.children(recursive=True)):
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total_s += times.user + times.system
    return total_s
