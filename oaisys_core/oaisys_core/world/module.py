"""The base classes of all simulation modules, and the world that they draw together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from pydantic import ValidationError

from oaisys_core.config.expectations import refusal
from oaisys_core.config.section import Section
from oaisys_core.errors import InvalidInputError, NotReadyError
from oaisys_core.procedural.terrain.detail import Detail, DetailedGround
from oaisys_core.procedural.terrain.surroundings.far_ground import FarGroundMesh
from oaisys_core.procedural.terrain.surroundings.kinds import Surroundings
from oaisys_core.procedural.terrain.water.beyond_stage import WaterBeyond, water_beyond
from oaisys_core.procedural.terrain.water.ponds import NO_WATER, Water
from oaisys_core.scene import (
    Ground,
    Lamp,
    MeshPrototype,
    PlacedCamera,
    Placement,
    Primitive,
    Scene,
    Sky,
    TerrainMaterial,
    WheelTracks,
)
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import FloatArray, Georeference, GroupCount, merge

Metadata = Mapping[str, Any] | None
"""The part of a step's metadata that a module receives, or None."""

T = TypeVar("T")
SectionT = TypeVar("SectionT", bound=Section)


@dataclass
class World:
    """A world while it is drawn: each module fills in its part and reads those of earlier modules.

    Attributes:
        sample_id: The sample that is being drawn, 0 for the batch itself. What a module draws for a
            sample may depend only on this id and the batch's seed, because a restored world may
            start at any sample.
        drawn_ground: The ground as the stage module drew it, before materials displace it.
        stage_notes: Facts about the stage: ``hash``, under which it can be reused, and ``holes``
            and ``filled_px`` of a ground from a file.
        has_rock_walls: Whether the ground is of a preset with walls of rock.
        georeference: Where the ground lies on its body; None if it is of no place.
        detail: How ``ground`` is refined near the cameras; None for no refinement.
        near_ground: The ground refined around the current cameras. What modules draw does not
            depend on it.
        lamps: The lamps that are on, in their own frames.
        T_map_base: (4, 4) pose of the rig.
        surroundings: What surrounds the stage.
        tracks: Tracks of rovers.
        far_ground: The ground around the stage, once the sky has shown it.
        water: Lakes and ponds on the stage.
        group_counts: Of each group of objects, how many were asked for and how many stand.
    """

    ground: Ground | None = None
    stage_hash: str = ""
    drawn_ground: Ground | None = None
    stage_notes: dict[str, Any] = field(default_factory=dict)
    has_rock_walls: bool = False
    georeference: Georeference | None = None
    detail: Detail | None = None
    near_ground: DetailedGround | None = None
    surroundings: Surroundings = field(default_factory=Surroundings)
    far_ground: FarGroundMesh | None = None
    water: Water | None = None
    material: TerrainMaterial | None = None
    prototypes: tuple[MeshPrototype, ...] = ()
    placements: tuple[Placement, ...] = ()
    primitives: tuple[Primitive, ...] = ()
    tracks: tuple[WheelTracks, ...] = ()
    group_counts: tuple[GroupCount, ...] = ()
    sky: Sky | None = None
    lamps: tuple[Lamp, ...] = ()
    T_map_base: FloatArray | None = None
    cameras: tuple[PlacedCamera, ...] = ()
    render: RenderSettings | None = None
    semantic_labels: dict[int, str] = field(default_factory=dict)
    sample_id: int = 0
    _beyond: WaterBeyond | None = None
    _on_stage: tuple[tuple[Placement, ...], tuple[Placement, ...]] | None = None

    def keep_stage(self, other: World) -> None:
        """Take over the ground and its material from another world."""
        self.ground, self.stage_hash = other.ground, other.stage_hash
        self.drawn_ground, self.stage_notes = other.drawn_ground, other.stage_notes
        self.has_rock_walls = other.has_rock_walls
        self.georeference, self.detail = other.georeference, other.detail
        self.surroundings, self.far_ground = other.surroundings, other.far_ground
        self.material, self.water = other.material, other.water
        layers = require(other.material).layers
        ids = {semantic_id for layer in layers for semantic_id in layer.all_semantic_ids}
        ids |= set(other.water.semantic_ids if other.water else ())
        labels = other.semantic_labels
        self.semantic_labels.update({i: labels[i] for i in ids if i in labels})

    @property
    def surface(self) -> Ground:
        """The ground as the cameras see it now."""
        return self.near_ground or require(self.ground)

    @property
    def is_in_land(self) -> bool:
        """Whether the ground beyond the stage, if it is shown, is land."""
        return self.ground is not None and self.surroundings.is_land(self.ground)

    def water_beyond(self) -> WaterBeyond | None:
        """Return the water on the land around the stage; None without water or land."""
        if self.water is None or not self.is_in_land:
            return None
        land = self.far_ground = self.surroundings.around(require(self.ground), self.far_ground)
        last = self._beyond
        if last is None or last.land is not land or last.water is not self.water:
            self._beyond = water_beyond(self.water, land, self.surroundings.body_radius_m)
        return self._beyond

    def _shown_placements(self, shows_land: bool) -> tuple[Placement, ...]:
        """Return the placements without those on land that is not shown; the same for the same."""
        if shows_land or not any(each.on_land for each in self.placements):
            return self.placements
        if self._on_stage is None or self._on_stage[0] is not self.placements:
            on_stage = tuple(each for each in self.placements if not each.on_land)
            self._on_stage = self.placements, on_stage
        return self._on_stage[1]

    def refine(self) -> None:
        """Refine the ground around the cameras, where it must change."""
        if self.detail is None or not self.cameras:
            return
        positions_m = np.array([camera.T_map_camera[:3, 3] for camera in self.cameras])
        self.near_ground = self.detail.around(require(self.ground), self.near_ground, positions_m)

    def scene(self) -> Scene:
        """Return what the backend builds.

        Raises:
            NotReadyError: A module has not drawn its part yet.
        """
        sky = require(self.sky)
        if sky.shows_plain:
            self.far_ground = self.surroundings.around(require(self.ground), self.far_ground)
        prototypes, placements = self.prototypes, self._shown_placements(sky.shows_plain)
        if self.water is not None:
            beyond = self.water_beyond() if sky.shows_plain else None
            parts = NO_WATER if beyond is None else beyond.parts
            prototypes, placements = self.water.join(prototypes, placements, parts)
        return Scene(
            ground=self.surface,
            material=require(self.material),
            prototypes=prototypes,
            placements=placements,
            primitives=self.primitives,
            tracks=self.tracks,
            sky=sky,
            semantic_labels=dict(sorted(self.semantic_labels.items())),
            stage_hash=self.stage_hash + (self.near_ground.tag if self.near_ground else ""),
            custom={"stage": dict(self.stage_notes)},
            lamps=tuple(lamp.in_map(self.T_map_base) for lamp in self.lamps),
            far_ground=self.far_ground if sky.shows_plain else None,
        )


def require(part: T | None) -> T:
    """Return a part of the world, or of a module, that a batch must have drawn by now.

    Raises:
        NotReadyError: There was no batch yet.
    """
    if part is None:
        raise NotReadyError("the world is not complete: step a batch first (StepBatch)")
    return part


class Module(ABC):
    """Draws one aspect of the world, without knowing the backend or the other modules.

    ``setup`` is called once and ``step_batch`` for each new world. ``step_sample`` is called for
    each sample with metadata for the module; for every sample, if the module `changes_by_itself` or
    a module of another package is used. All random numbers come from the generator that is passed
    in. It is derived from (seed, batch, module name), so that adding a module does not change what
    the others draw.
    """

    name: str
    """Key of the module's random stream and of its configuration section."""

    metadata_part: str
    """The part of `ModuleMetadata` that it receives; its own name means ``custom[name]``."""

    changes_by_itself: bool = True
    """Whether samples without metadata change the module's part of the world."""

    def setup(self) -> None:  # noqa: B027 - most modules need none
        """Prepare what the whole simulation needs."""

    def check(self, metadata: Metadata) -> None:
        """Raise if metadata cannot be applied to a batch; nothing changes.

        Raises:
            InvalidInputError: Names the key, the value and what was expected.
        """
        for key, value in (metadata or {}).items():
            raise InvalidInputError(f"metadata.{self.metadata_part}.{key}", value, "no such key")

    def check_sample(self, metadata: Metadata) -> None:
        """Raise if metadata cannot be applied to a sample, see `check`."""
        self.check(metadata)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the metadata with which `step_batch` brings the module to its current state.

        Args:
            metadata: All metadata since the batch began, merged key by key. A module for which
                this merge gives another result than the single steps overrides this method.
        """
        return metadata

    @abstractmethod
    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Draw the module's part of a new world."""

    def step_sample(  # noqa: B027 - what does not change from view to view has nothing to do
        self, world: World, metadata: Metadata, rng: np.random.Generator
    ) -> None:
        """Update what changes from sample to sample."""


def override(section: SectionT, metadata: Metadata, part: str) -> SectionT:
    """Return ``section`` with the fields in ``metadata`` replaced.

    Nested mappings are merged key by key, as in `ModuleMetadata.with_update`.

    Raises:
        InvalidInputError: A key is unknown or a value is invalid; its path starts with
            ``metadata.{part}``.
    """
    if not metadata:
        return section
    data = merge(section.model_dump(), metadata)
    try:
        return type(section).model_validate(data)
    except ValidationError as error:
        raise refusal(error, data, type(section), "metadata", part) from error


def differing(section: Section, changed: Section) -> dict[str, Any]:
    """Return, as JSON-compatible data, the fields that `override` needs to make ``changed``."""
    if changed is section:
        return {}
    before, after = section.model_dump(mode="json"), changed.model_dump(mode="json")
    return {name: value for name, value in after.items() if value != before[name]}


class SectionModule(Module, Generic[SectionT]):
    """A module whose configuration section may be overridden, field by field, at each step.

    A batch starts with the configured values; changes by a sample last until the next batch.
    """

    def __init__(self, config: SectionT) -> None:
        self._config = config
        self._now = config

    @abstractmethod
    def apply(self, world: World, section: SectionT) -> None:
        """Apply the section to the world."""

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys and invalid values."""
        override(self._now, metadata, self.metadata_part)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Start a batch with the configuration, changed by the metadata."""
        self._now = override(self._config, metadata, self.metadata_part)
        self.apply(world, self._now)

    def in_force(self, metadata: Metadata) -> Metadata:
        """Return the fields that differ from the configuration.

        Merged metadata would be wrong: if a field was set to null and then to a mapping, the merge
        would bring back the configured keys of that field.
        """
        return differing(self._config, self._now)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Apply the metadata to this and the following samples."""
        self._now = override(self._now, metadata, self.metadata_part)
        self.apply(world, self._now)
