"""A small data set, rendered in this process as workers render it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oaisys_core.config import config_from_mapping
from oaisys_core.dataset.manifest import WorldFailure, WorldLegend
from oaisys_core.dataset.places import open_place
from oaisys_core.dataset.plan import WorldTask
from oaisys_core.dataset.rendering import dataset_info
from oaisys_core.dataset.shards import HEAD, writing_shard
from oaisys_core.dataset.world_render import WorldRenderer

SMALL: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"extent_m": 40.0, "resolution_px": 65},
    "assets": {"rocks": [{"count": [30, 30], "size_m": [0.5, 1.5]}]},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 128}},
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
        with writing_shard(place, world) as shard:
            for each in renderer.render(WorldTask(world, 1000 + world, split, views)):
                assert not isinstance(each, WorldFailure), each.reason
                if isinstance(each, WorldLegend):
                    shard.finish(each)
                else:
                    for frame in each.frames:
                        shard.add_encoded(frame)
    renderer.close()
