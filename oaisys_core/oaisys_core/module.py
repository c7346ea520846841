"""The life that every module of the simulator shares, and the world that they draw together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from oaisys_core.backend.base import RenderSettings
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.scene import (
    Ground,
    MeshPrototype,
    PlacedCamera,
    Placement,
    Primitive,
    Scene,
    Sky,
    TerrainMaterial,
)

Metadata = Mapping[str, Any] | None
"""The part of a step's metadata that a module is given, or None."""


@dataclass
class World:
    """A world in the making: each module fills in its part and reads those of earlier ones.

    Attributes:
        sample_id: Of the sample in the making, 0 for the batch itself. What a sample draws may
            depend on it and the batch's seed alone, for a restored world begins in the middle.
    """

    ground: Ground | None = None
    stage_hash: str = ""
    material: TerrainMaterial | None = None
    prototypes: tuple[MeshPrototype, ...] = ()
    placements: tuple[Placement, ...] = ()
    primitives: tuple[Primitive, ...] = ()
    sky: Sky | None = None
    cameras: tuple[PlacedCamera, ...] = ()
    render: RenderSettings | None = None
    semantic_labels: dict[int, str] = field(default_factory=dict)
    sample_id: int = 0

    def keep_stage(self, other: World) -> None:
        """Take the ground and its material over from another world."""
        self.ground, self.stage_hash = other.ground, other.stage_hash
        self.material = other.material
        layers = drawn(other.material).layers
        ids = {semantic_id for layer in layers for semantic_id in layer.all_semantic_ids}
        labels = other.semantic_labels
        self.semantic_labels.update({i: labels[i] for i in ids if i in labels})

    def scene(self) -> Scene:
        """Return what the backend builds.

        Raises:
            NotReadyError: A module that must have drawn its part has not.
        """
        return Scene(
            ground=drawn(self.ground),
            material=drawn(self.material),
            prototypes=self.prototypes,
            placements=self.placements,
            primitives=self.primitives,
            sky=drawn(self.sky),
            semantic_labels=dict(sorted(self.semantic_labels.items())),
            stage_hash=self.stage_hash,
        )


T = TypeVar("T")


def drawn(part: T | None) -> T:
    """Return a part of the world, or of a module, that a batch has drawn.

    Raises:
        NotReadyError: There was no batch yet.
    """
    if part is None:
        raise NotReadyError("the world is not complete: step a batch first (StepBatch)")
    return part


class Module(ABC):
    """Decides one aspect of the world; knows neither the backend nor the other modules.

    ``setup`` once, then ``step_batch`` for each new world and ``step_sample`` for each view.
    Randomness comes only from the generator passed in, which is derived from (seed, batch,
    module name), so that adding a module does not reshuffle the others.
    """

    name: str
    """Key of the module's random stream and of its configuration section."""

    metadata_part: str
    """Which part of `ModuleMetadata` it is given; its own name stands for ``custom[name]``."""

    def setup(self) -> None:  # noqa: B027 - most modules need none
        """Prepare what lasts for the whole simulation."""

    def check(self, metadata: Metadata) -> None:
        """Refuse metadata that cannot be applied, before anything changes.

        Raises:
            InvalidInputError: Naming the key, the value and what was expected.
        """
        for key, value in (metadata or {}).items():
            raise InvalidInputError(f"metadata.{self.metadata_part}.{key}", value, "no such key")

    def check_sample(self, metadata: Metadata) -> None:
        """As `check`, for metadata of a sample; they differ where a module draws once a batch."""
        self.check(metadata)

    @abstractmethod
    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Draw the module's part of a new world."""

    def step_sample(  # noqa: B027 - what does not change from view to view has nothing to do
        self, world: World, metadata: Metadata, rng: np.random.Generator
    ) -> None:
        """Draw or take over what changes from view to view."""
