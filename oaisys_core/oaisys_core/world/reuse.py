"""Which seeds a batch is drawn from: its own, and those of a stage that it reuses."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from oaisys_core.config import SimulationConfig
from oaisys_core.config.sections.stage import ReuseConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import ModuleMetadata, merge
from oaisys_core.world.batch import Batch, BatchSeeds
from oaisys_core.world.module import require
from oaisys_core.world.modules.assets.module import AssetsModule
from oaisys_core.world.modules.stage import StageModule
from oaisys_core.world.stage_store import StageRecord

STAGE_MODULES = ("stage", "materials")
"""Modules whose part of the world belongs to a stage; their metadata is in ``custom``."""

NOTHING_SCATTERED = {"count_factor": 0.0}
"""Asset metadata with which nothing is scattered."""


def batch_seeds(
    stage: StageModule,
    assets: AssetsModule,
    assets_sha256: str,
    metadata: ModuleMetadata,
    seed: int,
    current: Batch | None,
    reuse_stage: bool,
) -> tuple[BatchSeeds, ModuleMetadata]:
    """Return the seeds of a new batch, and its metadata including that of what it keeps.

    Args:
        stage: Finds the stages that were stored.
        assets: Checks the metadata of objects that were stored.
        assets_sha256: Hash of the current asset configuration.
        metadata: Checked metadata of the batch.
        seed: Seed of the batch.
        current: The current batch.
        reuse_stage: Whether to keep its stage and draw everything else again.

    Raises:
        InvalidInputError: There is no such stage, or its objects cannot be reproduced.
    """
    reuse = stage.reuse(metadata.part(stage.name))
    if current is not None and reuse_stage:
        _refuse_others(metadata, STAGE_MODULES)
        return BatchSeeds(seed, current.seeds.stage_seed, seed), _on_stage_of(current, metadata)
    if reuse is None:
        return BatchSeeds(seed, seed, seed), metadata
    if current is not None and reuse.name == current.world.stage_notes.get("hash"):
        _refuse_others(metadata, STAGE_MODULES[1:])
        metadata = _on_stage_of(current, metadata)
        seeds = current.seeds
        kept = (seeds.stage_seed, seeds.asset_seed, current.metadata.asset)
    else:
        record = stage.record(reuse)
        if reuse.objects == "keep" and record.assets_sha256 != assets_sha256:
            expected = (
                "clear or redraw, because its objects were drawn from another asset configuration"
            )
            raise InvalidInputError("stage.reuse.objects", reuse.objects, expected)
        if reuse.objects == "keep":
            _check_stored(record, assets, reuse)
        kept = (record.stage_seed, record.asset_seed, record.asset_metadata)
    return _with_objects(reuse, seed, *kept, metadata)


def same_stage(seeds: BatchSeeds, metadata: ModuleMetadata, current: Batch | None) -> bool:
    """Return whether a new batch has the ground and material of the current one."""
    return (
        current is not None
        and current.seeds.stage_seed == seeds.stage_seed
        and all(current.metadata.part(part) == metadata.part(part) for part in STAGE_MODULES)
    )


def stage_record(batch: Batch, assets_sha256: str) -> StageRecord:
    """Return what is stored of the stage of a new batch."""
    return StageRecord(
        stage_hash=batch.world.stage_notes["hash"],
        ground=require(batch.world.drawn_ground),
        stage_seed=batch.seeds.stage_seed,
        asset_seed=batch.seeds.asset_seed,
        assets_sha256=assets_sha256,
        asset_metadata=batch.metadata.asset or {},
        has_rock_walls=batch.world.has_rock_walls,
    )


def assets_sha256(config: SimulationConfig) -> str:
    """Return the hash of what objects are drawn from, in all variants."""
    data = config.model_dump(mode="json")
    sections = [data["assets"], *(variant["assets"] for variant in data.get("variants", ()))]
    text = json.dumps(sections if config.variants else sections[0], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _check_stored(record: StageRecord, assets: AssetsModule, reuse: ReuseConfig) -> None:
    """Raise if metadata that somebody stored would be refused in a request."""
    try:
        assets.check(record.asset_metadata)
    except InvalidInputError as error:
        key, source = ("name", reuse.name) if reuse.file is None else ("file", str(reuse.file))
        expected = f"a stage that stage.store wrote ({error})"
        raise InvalidInputError(f"stage.reuse.{key}", source, expected) from error


def _with_objects(
    reuse: ReuseConfig,
    seed: int,
    stage_seed: int,
    asset_seed: int,
    kept: Mapping[str, Any] | None,
    metadata: ModuleMetadata,
) -> tuple[BatchSeeds, ModuleMetadata]:
    if reuse.objects == "keep":
        asset = merge(kept, metadata.asset)
        return BatchSeeds(seed, stage_seed, asset_seed), replace(metadata, asset=asset)
    if reuse.objects == "clear":
        metadata = replace(metadata, asset=merge(NOTHING_SCATTERED, metadata.asset))
    return BatchSeeds(seed, stage_seed, seed), metadata


def _on_stage_of(current: Batch, metadata: ModuleMetadata) -> ModuleMetadata:
    """Return metadata with the parts that the current stage was drawn with."""
    own = {name: part for name, part in metadata.custom.items() if name not in STAGE_MODULES}
    kept = {name: part for name, part in current.metadata.custom.items() if name in STAGE_MODULES}
    return replace(metadata, custom=own | kept)


def _refuse_others(metadata: ModuleMetadata, parts: tuple[str, ...]) -> None:
    for part in parts:
        if metadata.part(part):
            expected = "none for a batch that keeps the current stage"
            raise InvalidInputError(f"metadata.custom.{part}", metadata.part(part), expected)
