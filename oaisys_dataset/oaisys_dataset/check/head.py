"""The check of ``dataset.json``: against its configuration, and against the worlds on disk."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import fsum
from typing import NamedTuple

from oaisys_core.config import canonical_json, config_from_mapping, config_sha256
from oaisys_core.errors import ConfigError, OaisysError
from oaisys_dataset.check.manifests import DueViews, due_views
from oaisys_dataset.check.report import DatasetFinding
from oaisys_dataset.manifest import DatasetInfo
from oaisys_dataset.merging.layout import worlds_sha256
from oaisys_dataset.places import StoragePlace
from oaisys_dataset.plan import WorldTask, world_tasks
from oaisys_dataset.rendering.dataset_rendering import first_difference
from oaisys_dataset.shards import (
    HEAD,
    SHARDS,
    failure_name,
    read_failure,
    tar_name,
    whole_worlds,
    world_failures,
)

LARGEST_SUM_ERROR = 1e-6
"""Of the shares of all splits."""


class PlannedPart(NamedTuple):
    """What one command was to render, as its worlds are checked against it.

    Attributes:
        first_world: The number of its first world.
        info: What it was planned as.
        due: The views at which sensors are due; none if the configuration cannot be used.
        drawn_from: See `worlds_sha256`.
    """

    first_world: int
    info: DatasetInfo
    due: DueViews
    drawn_from: str


def part_plans(info: DatasetInfo) -> tuple[list[PlannedPart], list[DatasetFinding]]:
    """Return the parts of a data set, and how their heads contradict their configurations."""
    parts: list[PlannedPart] = []
    findings: list[DatasetFinding] = []
    for first_world, of_part in info.parts:
        due = DueViews({}, {}, {})
        try:
            due = due_views(of_part)
            texts = list(_contradictions(of_part))
        except ConfigError as error:
            texts = [str(error)]
        parts.append(PlannedPart(first_world, of_part, due, worlds_sha256(of_part)))
        where = f"{HEAD}, from world {first_world}" if info.merged else HEAD
        findings += (DatasetFinding("head", where, text) for text in texts)
    if info.merged:
        findings += (DatasetFinding("head", HEAD, text) for text in _merge_faults(info))
    return parts, findings


def world_plans(parts: list[PlannedPart]) -> dict[int, WorldTask]:
    """Return the plan of each world by its number."""
    return {
        part.first_world + task.index: task
        for part in parts
        for task in world_tasks(part.info.seed, part.info.worlds, part.info.views, part.info.splits)
    }


def world_faults(place: StoragePlace, info: DatasetInfo) -> Iterator[DatasetFinding]:
    """Yield which worlds are missing, too many, without a manifest, or both whole and failed."""
    finished, failed = whole_worlds(place), world_failures(place)
    missing = sorted(set(range(info.worlds)) - {*finished, *failed})
    if missing:
        shown = ", ".join(map(str, missing[:5]))
        text = f"{len(missing)} of {info.worlds} worlds are not finished: {shown}"
        yield DatasetFinding("missing", HEAD, text)
    for world in finished:
        if world >= info.worlds:
            yield DatasetFinding("head", tar_name(world), "the data set has fewer worlds")
    whole = {tar_name(world) for world in finished}
    for name in place.names(SHARDS):
        if name.endswith(".tar") and name not in whole:
            yield DatasetFinding("shard", name, "it has no manifest")
    for world in failed:
        yield from _failure_faults(place, info, world, is_finished=world in finished)


def _contradictions(info: DatasetInfo) -> Iterator[str]:
    """Yield how the head of a data set contradicts its configuration."""
    config = config_from_mapping(info.config)
    sha256 = config_sha256(config)
    if sha256 != info.config_sha256:
        yield f"its configuration has the hash {sha256}, recorded is another one"
    elif difference := first_difference(json.loads(canonical_json(config)), info.config):
        path, expected, received = difference
        yield f"config.{path} is {received!r}, expected {expected!r}, as its hash says"
    if config.seed != info.seed:
        yield f"seed is {info.seed}, expected {config.seed}, as its configuration says"
    total = fsum(info.splits.values())
    if abs(total - 1) > LARGEST_SUM_ERROR:
        yield f"the shares of splits sum to {total:g}, expected 1"


def _merge_faults(info: DatasetInfo) -> Iterator[str]:
    """Yield how the head of a merged set contradicts its parts."""
    first = info.merged[0]
    for name in ("config", "config_sha256", "seed", "software"):
        if getattr(info, name) != getattr(first, name):
            yield f"{name} is not that of its first part"
    views = max(part.views for part in info.merged)
    if info.views != views:
        yield f"views are {info.views}, expected {views}, the most of its parts"
    for split in {*info.splits, *(name for part in info.merged for name in part.splits)}:
        planned = fsum(part.splits.get(split, 0.0) * part.worlds for part in info.merged)
        share = info.splits.get(split, 0.0)
        if abs(share - planned / info.worlds) > LARGEST_SUM_ERROR:
            yield f"the share of {split!r} is {share:g}, expected {planned / info.worlds:g}"


def _failure_faults(
    place: StoragePlace, info: DatasetInfo, world: int, *, is_finished: bool
) -> Iterator[DatasetFinding]:
    """Yield what is wrong with the record of a world that could not be made."""
    name = failure_name(world)
    if is_finished:
        yield DatasetFinding("head", name, "the world is finished, too")
    try:
        failure = read_failure(place, world)
    except OaisysError as error:
        yield DatasetFinding("manifest", name, str(error))
        return
    if failure.world != world:
        yield DatasetFinding("manifest", name, f"it is of world {failure.world}, expected {world}")
    if world >= info.worlds:
        yield DatasetFinding("head", name, "the data set has fewer worlds")
    elif failure.split not in info.splits:
        expected = ", ".join(info.splits)
        yield DatasetFinding("split", name, f"{failure.split!r}, expected one of {expected}")
