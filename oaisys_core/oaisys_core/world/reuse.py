"""What a batch is drawn from: its own seed, or in part those of a stage that is reused."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from oaisys_core.config.section import Section
from oaisys_core.config.sections.stage import ReuseConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.modules.stage import StageModule
from oaisys_core.types import ModuleMetadata, merged
from oaisys_core.world.batch import Batch

STAGE_MODULES = ("stage", "materials")
"""Modules whose part of the world stays with a stage; parts of ``ModuleMetadata.custom``."""

NOTHING_SCATTERED = {"count_factor": 0.0}
"""Metadata of assets with which nothing is scattered."""


@dataclass(frozen=True)
class BatchSeeds:
    """Seeds of a batch: of itself, of its ground and material, and of its things."""

    seed: int
    stage_seed: int
    asset_seed: int


def batch_seeds(
    stage: StageModule,
    assets_sha256: str,
    metadata: ModuleMetadata,
    seed: int,
    standing: Batch | None,
    reuse_stage: bool,
) -> tuple[BatchSeeds, ModuleMetadata]:
    """Return what a new batch is drawn from, and its metadata with that of what it keeps.

    Args:
        stage: Knows what is kept.
        assets_sha256: Of the present configuration of assets.
        metadata: Of the batch, checked.
        seed: Of the batch.
        standing: The batch that stands now.
        reuse_stage: Whether to stay on its stage, with everything else drawn anew.

    Raises:
        InvalidInputError: There is no such stage, or its things cannot be drawn again.
    """
    reuse = stage.reuse(metadata.part(stage.name))
    if standing is not None and reuse_stage:
        _refuse_others(metadata, STAGE_MODULES)
        return BatchSeeds(seed, standing.stage_seed, seed), _on_stage_of(standing, metadata)
    if reuse is None:
        return BatchSeeds(seed, seed, seed), metadata
    if standing is not None and reuse.name == standing.world.stage_notes.get("hash"):
        _refuse_others(metadata, STAGE_MODULES[1:])
        metadata = _on_stage_of(standing, metadata)
        kept = (standing.stage_seed, standing.asset_seed, standing.metadata.asset)
    else:
        record = stage.record(reuse)
        if reuse.objects == "keep" and record.assets_sha256 != assets_sha256:
            expected = "clear or redraw: its things were drawn from another configuration of assets"
            raise InvalidInputError("stage.reuse.objects", reuse.objects, expected)
        kept = (record.stage_seed, record.asset_seed, record.asset_metadata)
    return _with_objects(reuse, seed, *kept, metadata)


def same_stage(origin: BatchSeeds, metadata: ModuleMetadata, standing: Batch | None) -> bool:
    """Return whether a batch has the ground and material of the one that stands."""
    return (
        standing is not None
        and standing.stage_seed == origin.stage_seed
        and all(standing.metadata.part(part) == metadata.part(part) for part in STAGE_MODULES)
    )


def section_sha256(section: Section) -> str:
    """Return the hash of a part of the configuration."""
    text = json.dumps(section.model_dump(mode="json"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _with_objects(
    reuse: ReuseConfig,
    seed: int,
    stage_seed: int,
    asset_seed: int,
    kept: Mapping[str, Any] | None,
    metadata: ModuleMetadata,
) -> tuple[BatchSeeds, ModuleMetadata]:
    if reuse.objects == "keep":
        asset = merged(kept, metadata.asset)
        return BatchSeeds(seed, stage_seed, asset_seed), replace(metadata, asset=asset)
    if reuse.objects == "clear":
        metadata = replace(metadata, asset=merged(NOTHING_SCATTERED, metadata.asset))
    return BatchSeeds(seed, stage_seed, seed), metadata


def _on_stage_of(standing: Batch, metadata: ModuleMetadata) -> ModuleMetadata:
    """Return metadata with what the standing stage was drawn with."""
    own = {name: part for name, part in metadata.custom.items() if name not in STAGE_MODULES}
    kept = {name: part for name, part in standing.metadata.custom.items() if name in STAGE_MODULES}
    return replace(metadata, custom=own | kept)


def _refuse_others(metadata: ModuleMetadata, parts: tuple[str, ...]) -> None:
    for part in parts:
        if metadata.part(part):
            expected = "none for a batch that stays on the stage that stands"
            raise InvalidInputError(f"metadata.custom.{part}", metadata.part(part), expected)
