"""A small data set, rendered in this process as workers render it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oaisys_core.config import config_from_mapping
from oaisys_dataset.manifest import WorldFailure
from oaisys_dataset.places import open_place
from oaisys_dataset.plan import WorldTask
from oaisys_dataset.rendering.dataset_rendering import dataset_info
from oaisys_dataset.rendering.workers import write_world
from oaisys_dataset.rendering.world_render import WorldRenderer
from oaisys_dataset.shards import HEAD

SMALL: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "extent_m": 40.0, "resolution_px": 65},
    "assets": {"rocks": [{"count": [10, 10], "size_m": [0.5, 1.5]}]},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}},
    "sensors": {
        "cameras": [
            {
                "name": "camera",
                "width_px": 96,
                "height_px": 72,
                "fx_px": 80.0,
                "fy_px": 75.0,
                "modalities": ["rgb", "depth", "semantic_0", "instance", "normal"],
            }
        ],
        "motion": {"kind": "around_target", "distance_m": [6.0, 12.0]},
    },
}
"""Worlds in which a view takes milliseconds."""

LIDARS: list[dict[str, Any]] = [
    {
        "name": "roof",
        "mount_position_m": [0.1, 0.0, 0.3],
        "scan": {"kind": "rotating", "channels": 16, "azimuth_steps": 90},
        "sweep_share": 0.5,
        "extra_fields": ["label", "instance"],
    },
    {
        "name": "front",
        "mount_quat_xyzw": [0.0, 0.17364818, 0.0, 0.98480775],
        "scan": {"kind": "raster", "columns": 40, "rows": 20},
        "step_interval": 2,
    },
    {
        "name": "rosette",
        "scan": {"kind": "rosette", "points": 500},
        "beam_divergence_mrad": 3.0,
    },
]
"""A lidar that moves while it scans, one that scans every other view, and one with wide beams."""

SCANNED: dict[str, Any] = {**SMALL, "sensors": {**SMALL["sensors"], "lidars": LIDARS}}
"""The same worlds, with lidars beside the camera."""


def render_dataset(
    where: str | Path, splits: Mapping[int, str], views: int, config: Mapping[str, Any] = SMALL
) -> None:
    """Render a data set.

    Args:
        where: Its place.
        splits: The split of each world.
        views: Number of views of each world.
        config: The configuration.
    """
    chosen = config_from_mapping(config)
    place = open_place(where)
    shares = dict.fromkeys(splits.values(), 1 / len(set(splits.values())))
    info = dataset_info(chosen, len(splits), views, shares)
    place.write(HEAD, info.to_json().encode())
    renderer = WorldRenderer(chosen, "here")
    for world, split in splits.items():
        task = WorldTask(world, 1000 + world, split, views)
        *_, last = write_world(place, task, renderer.render(task))
        assert not isinstance(last, WorldFailure), last.reason
    renderer.close()
