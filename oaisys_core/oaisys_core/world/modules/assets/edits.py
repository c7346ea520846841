"""The objects of a batch after the edits in metadata."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.section import Labelled
from oaisys_core.config.sections.objects import ShapedConfig
from oaisys_core.errors import InvalidInputError, quote
from oaisys_core.procedural.scatter.ids import id_of_added
from oaisys_core.procedural.scatter.shapes import PLANTS
from oaisys_core.raycast.clearance import MAX_EXTENTS
from oaisys_core.scene import Ground, MeshPrototype, Placement
from oaisys_core.system.ending.interruption import stop_if_unwanted
from oaisys_core.world.module import World, require
from oaisys_core.world.modules.assets.drawing import (
    AssetPlacement,
    DrawnAssets,
    single,
    static_pose,
)
from oaisys_core.world.modules.assets.edit_functions import (
    edit_placement,
    edit_primitives,
    without_hidden,
)
from oaisys_core.world.modules.assets.metadata import (
    PART,
    AddedConfig,
    AssetMetadata,
    GroupEdit,
    ObjectEdit,
)
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary

T = TypeVar("T")

LABELS = set(Labelled.model_fields)
"""Keys that do not change what an object looks like."""

Changed = tuple[Hashable, Placement, Placement]
"""The edits of a placement, the original placement, and the edited one."""


@dataclass
class EditCache:
    """Results of earlier edits, so that what does not change stays the same Python object.

    Attributes:
        placements: The placements, with movers at their current poses.
        prototypes: Those of the batch, and those of added objects.
        shared: Index into ``prototypes`` by the appearance of added objects.
        changed: Edited placements, by index into ``placements`` or by the name of an added object.
        own_labels: Semantic ids that were added to the world's labels with added objects.
        edits: The current edits of the primitives.
    """

    placements: list[AssetPlacement]
    prototypes: list[MeshPrototype]
    shared: dict[Hashable, int] = field(default_factory=dict)
    changed: dict[object, Changed] = field(default_factory=dict)
    own_labels: set[int] = field(default_factory=set)
    edits: dict[int, ObjectEdit] | None = None

    def copy(self) -> EditCache:
        """Return a copy that can be changed independently."""
        return replace(
            self,
            placements=list(self.placements),
            prototypes=list(self.prototypes),
            shared=dict(self.shared),
            changed=dict(self.changed),
            own_labels=set(self.own_labels),
        )


class EditedAssets:
    """The objects of a batch with edits applied; unedited ones stay the same Python objects.

    Args:
        world: The world of the objects.
        rng: Seeds the shapes of added objects, each by its name.
    """

    def __init__(
        self,
        things: DrawnAssets,
        world: World,
        library: PrototypeLibrary,
        rng: np.random.Generator,
        cache: EditCache | None = None,
    ) -> None:
        self._drawn, self._world, self._library, self._rng = things, world, library, rng
        self._cache = cache or EditCache(list(things.placements), list(things.prototypes))

    def in_world(self, world: World) -> EditedAssets:
        """Return an independent copy of the objects for another world."""
        return EditedAssets(self._drawn, world, self._library, self._rng, self._cache.copy())

    def check(self, metadata: AssetMetadata) -> None:
        """Raise if an edited object does not exist, or an added object is not possible.

        Raises:
            InvalidInputError: Its path begins with ``metadata.asset``.
        """
        known = self._drawn.instances.keys() | self._drawn.primitive_ids
        self._check_reach(metadata)
        for key in metadata.objects:
            if int(key) not in known:
                path = f"metadata.{PART}.objects.{key}"
                raise InvalidInputError(path, key, "the instance id of an object in this batch")
        labels = {
            semantic_id: label
            for semantic_id, label in self._world.semantic_labels.items()
            if semantic_id not in self._cache.own_labels
        }
        check_labels(metadata, labels)
        for name, spec in metadata.additions.items():
            static_pose(spec, self._ground, f"metadata.{PART}.add.{name}")

    @property
    def groups(self) -> list[str]:
        """Group name, or "", of each of the world's placements, without those of added objects."""
        return [each.group for each in self._cache.placements]

    def _check_reach(self, metadata: AssetMetadata) -> None:
        """Raise if a position is farther away than a camera may be."""
        x0, y0, x1, y1 = self._ground.extent_m
        reach_m = MAX_EXTENTS * max(x1 - x0, y1 - y0)
        centre_m = np.array(((x0 + x1) / 2, (y0 + y1) / 2, 0.0))
        places = {f"add.{name}": spec.position_m for name, spec in metadata.additions.items()} | {
            f"objects.{key}": edit.position_m
            for key, edit in metadata.objects.items()
            if edit is not None and edit.position_m is not None
        }
        for name, position_m in places.items():
            if np.abs(position_m - centre_m).max() > reach_m:
                expected = f"at most {reach_m:g} m from the stage's centre along each axis"
                path = f"metadata.{PART}.{name}.position_m"
                raise InvalidInputError(path, list(position_m), expected)

    def apply(self, metadata: AssetMetadata) -> None:
        """Apply the edits in metadata to the world at its current sample."""
        world = self._world
        self._move(world.sample_id, metadata.time_s)
        edits = self._edits_by_placement(metadata)
        placements = [
            self._edit(index, each, metadata.group(each.group), edits.get(index, ()))
            for index, each in enumerate(self._cache.placements)
        ]
        placements += [self._add(name, spec) for name, spec in metadata.additions.items()]
        world.placements = _keep_same(world.placements, placements)
        edits_of_all = metadata.object_edits
        if edits_of_all != self._cache.edits:
            world.primitives = edit_primitives(self._drawn.primitives, edits_of_all)
            self._cache.edits = edits_of_all
        world.prototypes = _keep_same(world.prototypes, self._cache.prototypes)
        self._label(metadata)

    @property
    def _ground(self) -> Ground:
        return require(self._world.ground)

    def _move(self, sample_id: int, time_s: float | None) -> None:
        """Move the movers to their poses at a sample or a time; resting ones stay the same."""
        movers = [each for each in self._drawn.movers if each.leaves_tracks]
        tracks = tuple(each.tracks_at(sample_id, time_s) for each in movers)
        if [each.driven_share for each in tracks] != [
            each.driven_share for each in self._world.tracks
        ]:
            self._world.tracks = tracks
        for mover in self._drawn.movers:
            each = self._cache.placements[mover.index]
            T_map_object = mover.pose_at(sample_id, self._ground, time_s)[None]
            if not np.array_equal(T_map_object, each.placement.T_map_object):
                moved = replace(each.placement, T_map_object=T_map_object)
                self._cache.placements[mover.index] = replace(each, placement=moved)

    def _edits_by_placement(
        self, metadata: AssetMetadata
    ) -> dict[int, tuple[tuple[int, ObjectEdit], ...]]:
        """Return the edits of single instances, by the index of their placement."""
        edits: dict[int, tuple[tuple[int, ObjectEdit], ...]] = {}
        for instance_id, edit in sorted(metadata.object_edits.items()):
            index = self._drawn.instances.get(instance_id)
            if index is not None:
                edits[index] = (*edits.get(index, ()), (instance_id, edit))
        return edits

    def _edit(
        self,
        index: int,
        each: AssetPlacement,
        group: GroupEdit,
        edits: Sequence[tuple[int, ObjectEdit]],
    ) -> Placement:
        change = (group.scale, group.hidden, *edits)
        if change == (1.0, None) and not each.hidden:
            return each.placement
        known = self._cache.changed.get(index)
        if known is None or known[0] != change or known[1] is not each.placement:
            known = (change, each.placement, edit_placement(each, group, edits))
            self._cache.changed[index] = known
        return known[2]

    def _add(self, name: str, spec: AddedConfig) -> Placement:
        known = self._cache.changed.get(name)
        if known is None or known[0] != spec:
            prototype = self._prototype_of(name, spec)
            T_map_object = static_pose(spec, self._ground, f"metadata.{PART}.add.{name}")
            placement = single(prototype, spec.semantic_ids, T_map_object, id_of_added(name))
            visible = without_hidden(placement, np.array([not spec.hidden]))
            known = self._cache.changed[name] = (spec, placement, visible)
        return known[2]

    def _prototype_of(self, name: str, spec: AddedConfig) -> int:
        """Return the index of an added object's prototype; equal ones are shared."""
        if spec.prototype is not None:
            return self._drawn.first_prototype[spec.prototype]
        look = spec.model_dump_json(include=set(ShapedConfig.model_fields) - LABELS)
        key = (name if spec.file is None else "", look, spec.scale if spec.shape in PLANTS else 1.0)
        if key not in self._cache.shared:
            stop_if_unwanted()
            rng = randomness.child(self._rng, f"add/{name}")
            self._cache.shared[key] = len(self._cache.prototypes)
            self._cache.prototypes.append(self._library.prototype(spec, rng, plant_m=spec.scale))
        return self._cache.shared[key]

    def _label(self, metadata: AssetMetadata) -> None:
        """Add the labels of added objects, and remove those of objects that are gone."""
        labels = self._world.semantic_labels
        wanted = {k: v for spec in metadata.additions.values() for k, v in spec.labels.items()}
        for semantic_id in self._cache.own_labels - wanted.keys():
            del labels[semantic_id]
        self._cache.own_labels &= wanted.keys()
        for semantic_id, label in wanted.items():
            if semantic_id in self._cache.own_labels or semantic_id not in labels:
                labels[semantic_id] = label
                self._cache.own_labels.add(semantic_id)


def check_labels(metadata: AssetMetadata, labels: Mapping[int, str]) -> None:
    """Raise if an added object gives an id another name than ``labels`` or another object does.

    Raises:
        InvalidInputError: Its path begins with ``metadata.asset.add``.
    """
    names = dict(labels)
    for name, spec in metadata.additions.items():
        for semantic_id, label in spec.labels.items():
            known = names.setdefault(semantic_id, label)
            if known != label:
                path = f"metadata.{PART}.add.{name}.label"
                raise InvalidInputError(path, label, f"{quote(known)}, the name of {semantic_id}")


def _keep_same(old: tuple[T, ...], new: Sequence[T]) -> tuple[T, ...]:
    """Return ``old`` itself if it contains the same objects as ``new``."""
    same = len(old) == len(new) and all(a is b for a, b in zip(old, new, strict=True))
    return old if same else tuple(new)
