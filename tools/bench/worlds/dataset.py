"""The worlds and views of the topic ``dataset``; imports no Blender."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.types import DEPTH, INSTANCE, NORMAL, RGB, SEMANTIC_0, merge
from oaisys_dataset.plan import WorldTask, world_tasks
from tools.bench.settings import Settings
from tools.bench.worlds.panel import world_file, world_mapping

MODALITIES = [RGB, DEPTH, SEMANTIC_0, INSTANCE, NORMAL]

SPLITS = {"train": 1.0}

VIEWS_AHEAD = 2
"""Views of the first world that are rendered when the driver gets the first one: a view is sent
when the one after it is rendered. A data set and a plain loop are compared from there on."""

MOTION = {
    "kind": "hover",
    "look": "forward",
    "pitch_deg": [15, 70],
    "height_above_ground_m": [1.5, 6.0],
}
"""The same for all worlds, because not all of the panel's files move the camera by themselves."""


def dataset_config(
    settings: Settings, world: str, quality: str, changes: dict[str, Any] | None = None
) -> SimulationConfig:
    """Return the configuration of a data set of a world's kind."""
    mapping = merge(world_mapping(settings, world), changes or {})
    (camera,) = mapping["sensors"]["cameras"]
    sensors = {"cameras": [{**camera, "modalities": MODALITIES}], "motion": MOTION}
    render = {**mapping.get("render", {}), "quality": quality}
    complete = {**mapping, "sensors": sensors, "render": render}
    return config_from_mapping(complete, world_file(world).parent)


def dataset_tasks(config: SimulationConfig, worlds: int, views: int) -> Iterator[WorldTask]:
    """Yield the worlds of a data set."""
    return world_tasks(config.seed, worlds, views, SPLITS)
