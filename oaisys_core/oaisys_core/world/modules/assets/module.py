"""The module for objects on the ground: rocks, groups, objects, movers and primitives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from oaisys_core.config.sections.assets import AssetsConfig
from oaisys_core.config.sections.density import LayerDensity
from oaisys_core.config.sections.groups import MAX_INSTANCES
from oaisys_core.config.sections.objects import ShapedConfig
from oaisys_core.errors import ConfigError, InvalidInputError, one_of, quote
from oaisys_core.procedural.scatter.ids import (
    FIRST_MOVER_ID,
    FIRST_OBJECT_ID,
    InstanceIdPlan,
    id_of_added,
)
from oaisys_core.procedural.scatter.placement.beyond_stage import goes_beyond
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS
from oaisys_core.procedural.textures import TEXTURES
from oaisys_core.scene import TerrainMaterial
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import ObjectPage, ObjectQuery, merge
from oaisys_core.world.module import Metadata, Module, World, require
from oaisys_core.world.modules.assets.drawing import AssetGenerator, DrawnAssets, Site
from oaisys_core.world.modules.assets.edits import EditedAssets, check_labels
from oaisys_core.world.modules.assets.ground_cover import covers_of_layers
from oaisys_core.world.modules.assets.metadata import PART, AssetMetadata, asset_metadata
from oaisys_core.world.modules.assets.object_list import (
    ObjectInstances,
    box_of,
    check_query,
    page_of,
    solid,
)
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary
from oaisys_core.world.modules.assets.rock_faces import has_rock_faces


class AssetsModule(Module):
    """Draws the objects of each batch; metadata may move, hide and add objects."""

    name = "assets"
    metadata_part = PART

    def __init__(
        self, config: AssetsConfig, texture_size_px: int | None, texture_seed: int
    ) -> None:
        self._config = config
        self._plan = InstanceIdPlan(config)
        self._library = PrototypeLibrary(
            config.rock_texture, config.rock_tile_m, texture_size_px, texture_seed
        )
        faults = [str(fault) for fault in self._faults()]
        if faults:
            raise ConfigError("\n".join(faults))
        self._metadata: Mapping[str, Any] = {}
        self._edited: EditedAssets | None = None
        self._last: _PreviousDraw | None = None

    def setup(self) -> None:
        """Load or make the texture set of the rocks."""
        if self._config.rocks:
            self._library.rock_maps()

    def check(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values, and ids that no batch can have."""
        checked = asset_metadata({}, metadata)
        self._check_groups(checked)
        self._check_added(checked)
        labels = {k: v for thing in self._config.items_with_labels for k, v in thing.labels.items()}
        check_labels(checked, labels)
        for key in checked.objects:
            if not self._plan.knows(int(key)):
                path = f"metadata.{PART}.objects.{key}"
                raise InvalidInputError(path, key, "an instance id of this configuration")

    def check_sample(self, metadata: Metadata) -> None:
        """Raise on unknown keys, invalid values, ids that this batch does not have, and counts."""
        if not metadata:
            return
        _refuse_counts(metadata)
        checked = asset_metadata(self._metadata, metadata)
        self._check_groups(checked)
        self._check_added(checked)
        require(self._edited).check(checked)

    def step_batch(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Draw all objects of a new world; edits of ids that it does not have are ignored."""
        checked = asset_metadata({}, metadata)
        things = self._draw(world, checked, rng)
        world.primitives = things.primitives
        world.group_counts = things.counts
        for thing in self._config.items_with_labels:
            world.semantic_labels.update(thing.labels)
        self._metadata = merge({}, metadata)
        self.changes_by_itself = bool(things.movers)
        self._edited = EditedAssets(things, world, self._library, rng)
        self._edited.apply(checked)

    def step_sample(self, world: World, metadata: Metadata, rng: np.random.Generator) -> None:
        """Move the movers, and apply the metadata to this and the following samples."""
        self._metadata = merge(self._metadata, metadata)
        # If the sample fails, the old state is restored, so it must not be changed in place.
        self._edited = require(self._edited).in_world(world)
        self._edited.apply(asset_metadata({}, self._metadata))

    def list_objects(self, world: World, metadata: Metadata, query: ObjectQuery) -> ObjectPage:
        """Return the objects of a world after ``metadata`` is applied, without applying it.

        Raises:
            InvalidInputError: The query or the metadata is invalid.
        """
        check_query(query)
        self.check_sample(metadata)
        later = replace(world, semantic_labels=dict(world.semantic_labels))
        edited = require(self._edited).in_world(later)
        checked = asset_metadata(self._metadata, metadata)
        edited.apply(checked)
        return page_of(self._instances(later, edited, checked), later.semantic_labels, query)

    def _instances(
        self, world: World, edited: EditedAssets, metadata: AssetMetadata
    ) -> Iterable[ObjectInstances]:
        """Yield the objects of a world, prototype by prototype."""
        yield from map(solid, world.primitives)
        names = {FIRST_OBJECT_ID + i: each.name for i, each in enumerate(self._config.objects)}
        names |= {FIRST_MOVER_ID + i: each.name for i, each in enumerate(self._config.movers)}
        names |= {id_of_added(name): name for name in metadata.additions}
        groups = edited.groups
        for index, placement in enumerate(world.placements):
            if not len(placement.instance_ids) or placement.is_ground_cover:
                continue
            prototype = world.prototypes[placement.prototype]
            kind, group = "added", ""
            if index < len(groups):
                kind = self._plan.kind_of(int(placement.instance_ids[0]))
                group = prototype.name if kind == "rock" else groups[index]
            yield ObjectInstances(
                kind,
                group,
                placement.semantic_ids[0],
                placement.T_map_object,
                placement.instance_ids,
                *box_of(prototype),
                names,
            )

    def _brings_grass(self, world: World) -> bool:
        """Return whether a layer of the ground brings grass."""
        material = world.material
        return material is not None and bool(covers_of_layers(material, self._config.groups))

    def _material(self, world: World) -> TerrainMaterial | None:
        """Return the material of the ground if anything stands where a layer lies; else None."""
        densities = (each for group in self._config.groups for each in group.density)
        follows = any(isinstance(density, LayerDensity) for density in densities)
        material = world.material
        follows |= self._brings_grass(world) or (material is not None and has_rock_faces(material))
        return require(material) if follows else None

    def _draw(
        self,
        world: World,
        metadata: AssetMetadata,
        rng: np.random.Generator,
    ) -> DrawnAssets:
        """Draw all objects, or return those of the last batch if they would be the same."""
        material = self._material(world)
        water_m = None if world.water is None else world.water.level_m
        land, georeference = self._land(world), world.georeference
        beyond = None if land is None else world.water_beyond()
        site = Site(require(world.ground), material, land, water_m, georeference, beyond)
        before = rng.bit_generator.state
        last = self._last
        if last and last.site.is_same(site) and (last.metadata, last.before) == (metadata, before):
            rng.bit_generator.state = last.after
            return last.things
        generator = AssetGenerator(self._config, self._library, self._plan, site, rng)
        things = generator.draw(metadata)
        after = rng.bit_generator.state
        self._last = _PreviousDraw(site, metadata, before, after, things)
        return things

    def _land(self, world: World) -> FarGround | None:
        """Return the land around the stage; None if there is none, or nothing stands on it."""
        goes = self._brings_grass(world) or any(map(goes_beyond, self._config.groups))
        goes |= any(rocks.beyond_stage for rocks in self._config.rocks)
        if not (world.is_in_land and goes):
            return None
        world.far_ground = world.surroundings.around(require(world.ground), world.far_ground)
        return world.far_ground

    def _faults(self) -> Iterable[InvalidInputError]:
        """Yield an error for each name in the configuration that does not exist."""
        for index, group in enumerate(self._config.rocks):
            if group.kind not in ROCK_KINDS:
                path = f"assets.rocks.{index}.kind"
                yield InvalidInputError(path, group.kind, one_of(ROCK_KINDS, group.kind))
        rock_texture = self._config.rock_texture
        if rock_texture not in TEXTURES:
            expected = one_of(TEXTURES, rock_texture)
            yield InvalidInputError("assets.rock_texture", rock_texture, expected)
        for field, thing in self._sections_with_shape():
            try:
                self._library.check(thing, field)
            except InvalidInputError as error:
                yield error

    def _sections_with_shape(self) -> Iterable[tuple[str, ShapedConfig]]:
        """Yield everything in the configuration that has a shape, with its path."""
        for part in ("groups", "objects", "movers"):
            for index, thing in enumerate(getattr(self._config, part)):
                yield f"assets.{part}.{index}", thing

    def _check_groups(self, metadata: AssetMetadata) -> None:
        counts = {group.name: group.count[1] for group in self._config.groups}
        for name, edit in metadata.groups.items():
            path = f"metadata.{PART}.groups.{name}"
            if name not in counts:
                expected = f"the name of a group: {one_of(counts, name)}"
                raise InvalidInputError(path, name, expected)
            factor = metadata.count_factor * (edit.count_factor if edit else 1.0)
            if factor * counts[name] > MAX_INSTANCES:
                expected = f"at most {MAX_INSTANCES} instances in the group"
                raise InvalidInputError(f"{path}.count_factor", factor, expected)

    def _check_added(self, metadata: AssetMetadata) -> None:
        names = {getattr(thing, "name", "") for _, thing in self._sections_with_shape()}
        ids: dict[int, str] = {}
        for name, spec in metadata.additions.items():
            path = f"metadata.{PART}.add.{name}"
            self._library.check(spec, path)
            if spec.prototype is not None and spec.prototype not in names:
                known = one_of(names, spec.prototype)
                expected = f"the name of a group, object or mover: {known}"
                raise InvalidInputError(f"{path}.prototype", spec.prototype, expected)
            other = ids.setdefault(id_of_added(name), name)
            if other != name:
                raise InvalidInputError(
                    path, name, f"a name whose instance id differs from that of {quote(other)}"
                )


class _PreviousDraw(NamedTuple):
    """The inputs and the result of the last draw, with the generator's state before and after."""

    site: Site
    metadata: AssetMetadata
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    things: DrawnAssets


def _refuse_counts(metadata: Mapping[str, Any]) -> None:
    """Raise if metadata of a sample changes counts, which are drawn once per batch."""
    expected = "none at a sample step, because counts are drawn once per batch"
    path = f"metadata.{PART}"
    if "count_factor" in metadata:
        raise InvalidInputError(f"{path}.count_factor", metadata["count_factor"], expected)
    groups = metadata.get("groups")
    for name, edit in groups.items() if isinstance(groups, Mapping) else ():
        if isinstance(edit, Mapping) and "count_factor" in edit:
            received = edit["count_factor"]
            raise InvalidInputError(f"{path}.groups.{name}.count_factor", received, expected)
