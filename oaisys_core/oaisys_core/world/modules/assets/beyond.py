"""Draws the plants and rocks on the land around a stage."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.config.sections.assets import RockGroupConfig
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.meshes.thinning import thin_out
from oaisys_core.procedural.scatter.groups import WADING_M, poses_at
from oaisys_core.procedural.scatter.ids import IdBlock
from oaisys_core.procedural.scatter.placement.beyond_stage import (
    PlacesBeyond,
    places_beyond,
    plant_places_beyond,
)
from oaisys_core.procedural.scatter.placement.random_poses import poses_on, rim_m, slope_deg
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.water.beyond_stage import WaterBeyond
from oaisys_core.scene import MeshPrototype, Placement, TerrainMaterial
from oaisys_core.types import FloatArray

NEAR = 6.0
"""Distance from the stage, in units of a plant's size, from which plants are thinned out."""

FAR_TRIANGLES = 8_000
"""About the largest number of triangles of a plant that is thinned out."""


class ThingsOnStage(NamedTuple):
    """The plants of a group, or rocks of a kind, that stand on the stage.

    Attributes:
        shapes: Their prototypes.
        first: Index of the first one among those of the scene.
        T_map_object: (N, 4, 4) poses with scale.
        shape_of: (N,) indices into ``shapes``.
    """

    shapes: list[MeshPrototype]
    first: int
    T_map_object: FloatArray
    shape_of: NDArray[np.int64]


def plants_beyond(
    group: GroupConfig,
    plants: ThingsOnStage,
    ids: IdBlock,
    ground: GroundAround,
    material: TerrainMaterial | None,
    rng: np.random.Generator,
    next_prototype: int,
    water: WaterBeyond | None,
) -> tuple[list[MeshPrototype], list[Placement]]:
    """Return plants on the land like those of a stage: new prototypes, and placements.

    Args:
        next_prototype: Index that the first new prototype will have.
        water: On the land, in which few plants stand.
    """
    T_map_object, shape_of = plants.T_map_object, plants.shape_of
    sizes_m = np.linalg.norm(T_map_object[:, :3, 0], axis=1)
    is_under = None
    if water is not None:
        is_under = partial(water.covers, depth_m=WADING_M.get(group.shape or "", 0.0))
    places = randomness.child(rng, "places")
    xy_m = T_map_object[:, :2, 3]
    found = plant_places_beyond(group, xy_m, sizes_m, ground, material, places, is_under, ids.size)
    shape_of, sizes_m = shape_of[found.like], sizes_m[found.like]
    turns = randomness.child(rng, "turns")
    poses = poses_at(group, ground, found.xy_m, sizes_m, plants.shapes, shape_of, turns)
    numbers = ids.ids(len(poses))
    is_near = found.distance < NEAR
    prototypes: list[MeshPrototype] = []
    placements = []
    for variant, shape in enumerate(plants.shapes):
        for near in (True, False):
            chosen = (shape_of == variant) & (is_near == near)
            if not chosen.any():
                continue
            prototype = plants.first + variant
            thin = shape if near else thin_out(shape, FAR_TRIANGLES, randomness.child(rng, "thin"))
            if thin is not shape:
                prototype = next_prototype + len(prototypes)
                prototypes.append(thin)
            placements.append(
                Placement(
                    prototype, group.semantic_ids, poses[chosen], numbers[chosen], on_land=True
                )
            )
    return prototypes, placements


def rocks_beyond(
    group: RockGroupConfig,
    rocks: ThingsOnStage,
    ids: IdBlock,
    ground: GroundAround,
    rng: np.random.Generator,
) -> list[Placement]:
    """Return rocks on the land like those of a stage, wherever it is not too steep."""
    sizes_m = np.linalg.norm(rocks.T_map_object[:, :3, 0], axis=1)

    def is_gentle(found: PlacesBeyond) -> NDArray[np.bool_]:
        return np.asarray(slope_deg(ground, found.xy_m) <= group.max_slope_deg)

    places = randomness.child(rng, "places")
    xy_m, margin_m = rocks.T_map_object[:, :2, 3], rim_m(ground, sizes_m)
    found = places_beyond(xy_m, sizes_m, ground, places, is_gentle, margin_m)
    shape_of = rocks.shape_of[found.like]
    poses = poses_on(
        ground,
        found.xy_m,
        sizes_m[found.like],
        randomness.child(rng, "turns"),
        group.sink,
        rocks.shapes,
        shape_of,
    )
    numbers = ids.ids(len(poses))
    return placements_by_shape(
        rocks.first, shape_of, group.semantic_ids, poses, numbers, on_land=True
    )


def placements_by_shape(
    first: int,
    shape_of: NDArray[np.int64],
    semantic_ids: tuple[int, ...],
    T_map_object: FloatArray,
    instance_ids: NDArray[np.uint32],
    *,
    on_land: bool = False,
) -> list[Placement]:
    """Return the placements of instances of several shapes, one for each shape that occurs.

    Args:
        first: Index of the first shape among the prototypes of the scene.
        shape_of: (N,) numbers of their shapes, from 0.
        semantic_ids, T_map_object, instance_ids, on_land: See `Placement`.
    """
    return [
        Placement(
            first + shape,
            semantic_ids,
            T_map_object[shape_of == shape],
            instance_ids[shape_of == shape],
            on_land=on_land,
        )
        for shape in np.unique(shape_of).tolist()
    ]
