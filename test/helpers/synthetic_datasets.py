"""A small data set without a renderer, for tests of what reads data sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig, config_sha256
from oaisys_core.output.records import intrinsics_record
from oaisys_core.types import PinholeIntrinsics, Provenance
from oaisys_dataset.manifest import DatasetInfo, FrameRecord, LegendInstance, WorldLegend
from oaisys_dataset.places import open_place
from oaisys_dataset.records import frame_id
from oaisys_dataset.shards import HEAD, writing_shard

CAMERA = PinholeIntrinsics(16, 12, 14.0, 14.0, 7.5, 5.5)
LEGEND = WorldLegend(
    {1: "rock", 2: "sand"},
    {1: LegendInstance("rock_1", "rock", 1, "rock"), 70000: LegendInstance("far", "rock", 1)},
)


def dataset_info(worlds: int, views: int) -> DatasetInfo:
    """Return the head of a data set."""
    config = SimulationConfig(seed=3)
    return DatasetInfo(
        config=config.model_dump(mode="json"),
        config_sha256=config_sha256(config),
        seed=3,
        worlds=worlds,
        views=views,
        splits={"train": 0.5, "val": 0.5},
        software={"oaisys": "0.1.0"},
    )


def frame_record(world: int, view: int, split: str) -> FrameRecord:
    """Return the record of a frame, without images."""
    sha256 = dataset_info(1, 1).config_sha256
    pose = np.eye(4)
    pose[:3, 3] = world, view, 1 / 3
    provenance = Provenance(3, 100 + world, sha256, "analytic", "0", "standard", 4)
    return FrameRecord(
        frame_id=frame_id(world, view, "camera"),
        world=world,
        view=view,
        sensor="camera",
        split=split,
        world_seed=100 + world,
        config_sha256=sha256,
        metadata={"environment": {"sun": {"elevation_deg": 30.0}}},
        T_map_camera=tuple(tuple(row) for row in pose.tolist()),
        intrinsics=intrinsics_record(CAMERA),
        stamp_s=view / 10,
        images={},
        provenance=asdict(provenance),
        rig_pose={"position_m": [float(world), float(view), 1.0], "quat_xyzw": [0, 0, 0, 1.0]},
        worker="host:1",
        seconds=0.5,
        software={"oaisys": "0.1.0"},
    )


def drawn_arrays(rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """Return random pixels of all modalities that data sets usually have."""
    shape = CAMERA.height_px, CAMERA.width_px
    depth_m = rng.uniform(1, 60, shape).astype(np.float32)
    depth_m[0] = np.inf
    instance = rng.integers(0, 2, shape).astype(np.uint32)
    instance[-1, -1] = rng.choice([1, 70000])
    return {
        "rgb": rng.integers(0, 256, (*shape, 3)).astype(np.uint8),
        "depth": depth_m,
        "semantic_0": rng.integers(0, 3, shape).astype(np.uint16),
        "instance": instance,
        "normal": rng.normal(size=(*shape, 3)).astype(np.float32),
    }


def write_dataset(
    where: str | Path,
    worlds: Mapping[int, str],
    views: int = 3,
    legend: WorldLegend = LEGEND,
) -> dict[str, dict[str, NDArray[Any]]]:
    """Write a data set; return its arrays by frame id and modality.

    Args:
        where: Its place.
        worlds: The split of each world.
        views: Number of views of each world.
        legend: Of all worlds, beside a label of each one.
    """
    place = open_place(where)
    place.write(HEAD, dataset_info(max(worlds, default=0) + 1, views).to_json().encode())
    arrays = {}
    for world, split in worlds.items():
        with writing_shard(place, world) as shard:
            for view in range(views):
                pixels = drawn_arrays(np.random.default_rng([world, view]))
                record = shard.add(frame_record(world, view, split), pixels)
                arrays[record.frame_id] = pixels
            shard.finish(replace(legend, labels={**legend.labels, 3: f"of world {world}"}))
    return arrays
