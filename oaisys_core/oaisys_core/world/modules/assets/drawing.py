"""Draws the objects of a batch, before metadata edits them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import geometry, randomness
from oaisys_core.config.sections.assets import AssetsConfig, PrimitiveConfig
from oaisys_core.config.sections.groups import MAX_INSTANCES, GroupConfig
from oaisys_core.config.sections.objects import MoverConfig, ObjectConfig, PlacedObjectConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.scatter.groups import scatter_group
from oaisys_core.procedural.scatter.ids import (
    FIRST_MOVER_ID,
    FIRST_OBJECT_ID,
    IdBlock,
    InstanceIdPlan,
)
from oaisys_core.procedural.scatter.placement.beyond_stage import goes_beyond
from oaisys_core.procedural.scatter.placement.ground_pose import footprint_of
from oaisys_core.procedural.scatter.trajectories import make_trajectory
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.water.beyond_stage import WaterBeyond
from oaisys_core.scene import (
    Ground,
    MeshPrototype,
    Placement,
    Primitive,
    TerrainMaterial,
)
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import FloatArray, Georeference, GroupCount, Pose
from oaisys_core.world.modules.assets.beyond import ThingsOnStage, plants_beyond, rocks_beyond
from oaisys_core.world.modules.assets.ground_cover import (
    CoveredGround,
    covers_of_layers,
    draw_ground_cover,
)
from oaisys_core.world.modules.assets.metadata import AssetMetadata
from oaisys_core.world.modules.assets.movers import Mover, scale_pose
from oaisys_core.world.modules.assets.prototypes import PrototypeLibrary
from oaisys_core.world.modules.assets.rock_faces import draw_rock_faces
from oaisys_core.world.modules.assets.rocks import rock_poses, rock_shapes, rock_sizes_m


@dataclass(frozen=True)
class AssetPlacement:
    """A placement with the group it belongs to.

    Attributes:
        group: Name of the group, or "" if it belongs to none.
        hidden: Whether the configuration hides it.
    """

    placement: Placement
    group: str = ""
    hidden: bool = False


@dataclass(frozen=True)
class DrawnAssets:
    """All objects that were drawn for a batch.

    Attributes:
        first_prototype: By name of a group, object or mover, the index of its first prototype.
        counts: Of each group, how many were asked for and how many stand.
    """

    prototypes: tuple[MeshPrototype, ...]
    placements: tuple[AssetPlacement, ...]
    primitives: tuple[Primitive, ...]
    movers: tuple[Mover, ...]
    first_prototype: dict[str, int]
    counts: tuple[GroupCount, ...] = ()

    @cached_property
    def instances(self) -> dict[int, int]:
        """Index into ``placements`` by instance id, without what belongs to the ground."""
        return {
            instance_id: index
            for index, each in enumerate(self.placements)
            if not each.placement.is_ground_cover
            for instance_id in each.placement.instance_ids.tolist()
        }

    @property
    def primitive_ids(self) -> set[int]:
        """Instance ids of the primitives."""
        return {primitive.instance_id for primitive in self.primitives}


class Site(NamedTuple):
    """Where the objects of a batch stand.

    Attributes:
        material: Of the ground, if objects or grass stand where a layer lies; else None.
        land: Around the stage, if anything stands on it; else None.
        water_m: Level of the water on the stage; None: there is none.
        water_beyond: On that land; it follows from land and level.
    """

    ground: Ground
    material: TerrainMaterial | None
    land: FarGround | None
    water_m: float | None
    georeference: Georeference | None
    water_beyond: WaterBeyond | None

    def is_same(self, other: Site) -> bool:
        """Return whether the other has the identical ground, material and land, and the water."""
        parts = zip(self[:3], other[:3], strict=True)
        return self.water_m == other.water_m and all(one is another for one, another in parts)


class AssetGenerator:
    """Draws the objects of one batch: rocks, groups, objects and movers."""

    def __init__(
        self,
        config: AssetsConfig,
        library: PrototypeLibrary,
        plan: InstanceIdPlan,
        site: Site,
        rng: np.random.Generator,
    ) -> None:
        self._config, self._library, self._plan, self._site = config, library, plan, site
        self._ground, self._rng = site.ground, rng
        self._prototypes: list[MeshPrototype] = []
        self._placements: list[AssetPlacement] = []
        self._movers: list[Mover] = []
        self._first: dict[str, int] = {}
        self._counts: list[GroupCount] = []

    def draw(self, metadata: AssetMetadata) -> DrawnAssets:
        """Return everything on the ground.

        Raises:
            ConfigError: The image of a density cannot be read.
        """
        number = self._draw_rocks(metadata.count_factor)
        ids = self._plan.rocks.ids(number + len(self._config.primitives))[number:]
        primitives = tuple(
            make_primitive(primitive, int(instance_id))
            for primitive, instance_id in zip(self._config.primitives, ids, strict=True)
        )
        blocks = zip(self._plan.groups, self._plan.land, strict=True)
        for group, (block, on_land) in zip(self._config.groups, blocks, strict=True):
            factor = metadata.count_factor * metadata.group(group.name).count_factor
            self._draw_group(group, block, on_land, factor)
        self._draw_ground_cover()
        self._draw_rock_faces()
        for index, thing in enumerate(self._config.objects):
            self._add_object(thing, FIRST_OBJECT_ID + index)
        for index, mover in enumerate(self._config.movers):
            self._add_mover(mover, FIRST_MOVER_ID + index)
        return DrawnAssets(
            tuple(self._prototypes),
            tuple(self._placements),
            primitives,
            tuple(self._movers),
            self._first,
            tuple(self._counts),
        )

    def _draw_rocks(self, factor: float) -> int:
        """Draw all rocks from one random stream and return their number.

        Raises:
            InvalidInputError: They are more than `MAX_INSTANCES`, or those of one group are.
        """
        number = 0
        maps = self._library.rock_maps() if self._config.rocks else None
        for index, group in enumerate(self._config.rocks):
            shapes = rock_shapes(group, maps, self._rng)
            sizes_m = rock_sizes_m(group, factor, self._ground, self._rng)
            T_map_object, shape_of = rock_poses(group, sizes_m, self._ground, shapes, self._rng)
            if len(T_map_object) < len(sizes_m):
                placed = GroupCount(f"rocks.{index}", len(sizes_m), len(T_map_object))
                self._counts.append(placed)
            ids = self._plan.rocks.ids(number + len(T_map_object))[number:]
            number += len(T_map_object)
            if number > MAX_INSTANCES:
                expected = f"at most {MAX_INSTANCES} in all groups together"
                raise InvalidInputError("assets.rocks", f"{number} rocks", expected)
            on_stage = ThingsOnStage(shapes, len(self._prototypes), T_map_object, shape_of)
            self._place(shapes, shape_of, group.semantic_ids, T_map_object, ids)
            if self._site.land is None or not group.beyond_stage:
                continue
            around = GroundAround(self._site.ground, self._site.land)
            rng = randomness.child(self._rng, f"rocks/{index}/beyond")
            placements = rocks_beyond(group, on_stage, self._plan.rock_land[index], around, rng)
            self._placements.extend(AssetPlacement(each) for each in placements)
        return number

    def _draw_group(
        self, group: GroupConfig, block: IdBlock, on_land: IdBlock, factor: float
    ) -> None:
        rng = randomness.child(self._rng, f"group/{group.name}")
        shapes = self._library.group_prototypes(group, randomness.child(rng, "forms"))
        count = 0
        if randomness.child(rng, "presence").uniform() < group.probability:
            drawn = int(randomness.child(rng, "count").integers(*group.count, endpoint=True))
            count = min(round(factor * drawn), MAX_INSTANCES)
        site = self._site
        T_map_object, shape_of = scatter_group(
            group, count, shapes, site.ground, rng, site.material, site.water_m
        )
        ids = block.ids(len(T_map_object))
        self._counts.append(GroupCount(group.name, count, len(ids)))
        self._first[group.name] = len(self._prototypes)
        plants = ThingsOnStage(shapes, len(self._prototypes), T_map_object, shape_of)
        self._place(shapes, shape_of, group.semantic_ids, T_map_object, ids, group)
        if site.land is None or not goes_beyond(group) or not len(ids):
            return
        around = GroundAround(site.ground, site.land)
        self._place_beyond(group, plants, on_land, around, randomness.child(rng, "beyond"))

    def _draw_ground_cover(self) -> None:
        """Draw the grass and the stones that layers of the ground bring with them."""
        site = self._site
        if site.material is None:
            return
        covers = covers_of_layers(site.material, self._config.groups)
        covered = CoveredGround(
            site.ground, site.material, site.land, site.water_m, site.water_beyond
        )
        rng = randomness.child(self._rng, "ground cover")
        prototypes, placements = draw_ground_cover(covered, covers, len(self._prototypes), rng)
        self._prototypes.extend(prototypes)
        self._placements.extend(AssetPlacement(each) for each in placements)

    def _draw_rock_faces(self) -> None:
        """Draw the broken rock in the walls of the ground."""
        material = self._site.material
        if material is None:
            return
        rng = randomness.child(self._rng, "rock faces")
        prototypes, placements = draw_rock_faces(material, self._ground, len(self._prototypes), rng)
        self._prototypes.extend(prototypes)
        self._placements.extend(AssetPlacement(each) for each in placements)

    def _place_beyond(
        self,
        group: GroupConfig,
        plants: ThingsOnStage,
        ids: IdBlock,
        around: GroundAround,
        rng: np.random.Generator,
    ) -> None:
        """Add what a group has on the land around the stage."""
        material, water = self._site.material, self._site.water_beyond
        shapes, placements = plants_beyond(
            group, plants, ids, around, material, rng, len(self._prototypes), water
        )
        self._prototypes.extend(shapes)
        self._placements.extend(
            AssetPlacement(each, group.name, group.hidden) for each in placements
        )

    def _place(
        self,
        shapes: list[MeshPrototype],
        shape_of: NDArray[np.int64],
        semantic_ids: tuple[int, ...],
        T_map_object: FloatArray,
        ids: NDArray[np.uint32],
        group: GroupConfig | None = None,
    ) -> None:
        """Add instances of several shapes, one placement per shape."""
        for variant in range(len(shapes)):
            chosen = shape_of == variant
            placement = Placement(
                len(self._prototypes) + variant, semantic_ids, T_map_object[chosen], ids[chosen]
            )
            hidden = group is not None and group.hidden
            self._placements.append(AssetPlacement(placement, group.name if group else "", hidden))
        self._prototypes.extend(shapes)

    def _add_object(self, thing: ObjectConfig, instance_id: int) -> None:
        rng = randomness.child(self._rng, f"object/{thing.name}")
        T_map_object = static_pose(thing, self._ground, f"assets.objects.{thing.name}")
        look = self._library.prototype(thing, rng, plant_m=thing.scale)
        self._add_single(look, thing, T_map_object, instance_id)

    def _add_mover(self, mover: MoverConfig, instance_id: int) -> None:
        rng = randomness.child(self._rng, f"mover/{mover.name}")
        look = self._library.prototype(mover, rng, plant_m=mover.scale)
        foot_m = footprint_of(look).foot_m * mover.scale if mover.on_ground else None
        moves = Mover(
            index=len(self._placements),
            trajectory=make_trajectory(
                mover.trajectory, self._site.georeference, f"assets.movers.{mover.name}.trajectory"
            ),
            scale=mover.scale,
            foot_m=foot_m,
            leaves_tracks=mover.on_ground and mover.shape == "rover" and not mover.hidden,
        )
        self._movers.append(moves)
        T_map_object = moves.pose_at(0, self._ground)
        self._add_single(look, mover, T_map_object, instance_id, is_moving=True)

    def _add_single(
        self,
        look: MeshPrototype,
        config: ObjectConfig | MoverConfig,
        T_map_object: FloatArray,
        instance_id: int,
        is_moving: bool = False,
    ) -> None:
        index = len(self._prototypes)
        self._first.setdefault(config.name, index)
        self._prototypes.append(look)
        placement = single(index, config.semantic_ids, T_map_object, instance_id)
        self._placements.append(
            AssetPlacement(replace(placement, is_moving=is_moving), hidden=config.hidden)
        )


def single(
    prototype: int, semantic_ids: tuple[int, ...], T_map_object: FloatArray, instance_id: int
) -> Placement:
    """Return the placement of a single instance."""
    ids = np.array([instance_id], np.uint32)
    return Placement(prototype, semantic_ids, T_map_object[None], ids)


def static_pose(config: PlacedObjectConfig, ground: Ground, field: str) -> FloatArray:
    """Return the (4, 4) pose with scale of an object at a fixed place; ``field`` is for errors.

    Raises:
        InvalidInputError: It should stand on the ground, but is outside the stage.
    """
    T = geometry.pose_to_matrix(geometry.check_pose(config.position_m, config.quat_xyzw))
    if config.on_ground:
        ground_m = float(ground.height_at([config.position_m[:2]])[0])
        if not np.isfinite(ground_m):
            path = f"{field}.position_m"
            raise InvalidInputError(path, list(config.position_m), "a position on the stage")
        T[2, 3] += ground_m
    return scale_pose(T, config.scale)


def make_primitive(config: PrimitiveConfig, instance_id: int) -> Primitive:
    """Return the primitive of a configuration."""
    return Primitive(
        shape=config.shape,
        size_m=config.size_m,
        T_map_object=geometry.pose_to_matrix(Pose(config.position_m, config.quat_xyzw)),
        instance_id=instance_id,
        semantic_ids=config.semantic_ids,
        color_srgb=config.color_srgb,
    )
