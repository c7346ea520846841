"""Draws the grass that layers of the ground bring with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.sections.density import LayerDensity
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.ids import NO_OVERFLOW, IdBlock
from oaisys_core.procedural.scatter.placement.ground_cover import tones_at, tuft_places, tuft_poses
from oaisys_core.procedural.scatter.plants.swards import SWARDS, Tuft, blade_color, make_tuft
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.water.beyond_stage import WaterBeyond
from oaisys_core.scene import Ground, MeshPrototype, Placement, TerrainLayer, TerrainMaterial
from oaisys_core.scene.objects import FIRST_COVER_ID
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.world.modules.assets.beyond import (
    ThingsOnStage,
    placements_by_shape,
    plants_beyond,
)

FORMS = 3
"""Meshes of one kind and colour."""

MOST_BEYOND = 4000
"""Largest number of tufts of one kind on the land around the stage."""

GRASSES = frozenset({"grass_tuft", "meadow", "flower_meadow"})
"""Shapes of groups that take the place of a layer's own grass."""


class CoveredGround(NamedTuple):
    """What grass stands on.

    Attributes:
        stage: The ground.
        material: Of the ground.
        land: Around the stage, if grass stands on it; else None.
        water_m: Level of the water on the stage; None: there is none.
        water_beyond: On that land.
    """

    stage: Ground
    material: TerrainMaterial
    land: FarGround | None
    water_m: float | None
    water_beyond: WaterBeyond | None


def layers_with_grass(material: TerrainMaterial, groups: Sequence[GroupConfig]) -> list[int]:
    """Return the indices of the layers that bring grass, which no group of grass replaces."""
    own = {
        label
        for group in groups
        if group.shape in GRASSES
        for density in group.density
        if isinstance(density, LayerDensity)
        for label in density.labels
    }
    layers = enumerate(material.layers)
    return [index for index, layer in layers if layer.sward and layer.label not in own]


def draw_ground_cover(
    covered: CoveredGround, layers: Sequence[int], first_prototype: int, rng: np.random.Generator
) -> tuple[list[MeshPrototype], list[Placement]]:
    """Return the grass of layers: prototypes, the first of a given index, and placements.

    Args:
        covered: What it stands on.
        layers: Indices of the layers.
        first_prototype: Index of the first prototype among those of the scene.
        rng: Draws it.
    """
    prototypes: list[MeshPrototype] = []
    placements: list[Placement] = []
    next_id = FIRST_COVER_ID
    for layer in layers:
        for number, tuft in enumerate(SWARDS[covered.material.layers[layer].sward or ""]):
            own = randomness.child(rng, f"{layer}/{number}")
            index = first_prototype + len(prototypes)
            for shapes, placed in _draw_tufts(covered, layer, tuft, index, next_id, own):
                prototypes += shapes
                placements += placed
                next_id += sum(len(each.instance_ids) for each in placed)
    return prototypes, placements


def _draw_tufts(
    covered: CoveredGround,
    layer: int,
    tuft: Tuft,
    first: int,
    first_id: int,
    rng: np.random.Generator,
) -> Iterator[tuple[list[MeshPrototype], list[Placement]]]:
    """Yield the tufts of one kind on the stage, and those on the land around it."""
    material, ground = covered.material, covered.stage
    of_layer = material.layers[layer]
    places = randomness.child(rng, "places")
    xy_m, sizes_m = tuft_places(tuft, layer, material, ground, places, covered.water_m)
    tone, factors = tones_at(material, xy_m)
    color = blade_color(of_layer.maps)
    forms = randomness.child(rng, "forms")
    shapes = [
        make_tuft(f"{of_layer.label}_grass", tuft, color * factor, forms)
        for factor in factors
        for _ in range(FORMS)
    ]
    form = randomness.child(rng, "shapes").integers(FORMS, size=len(xy_m))
    shape_of = np.asarray(tone * FORMS + form, np.int64)
    group = _as_group(of_layer, tuft)
    poses = tuft_poses(ground, xy_m, sizes_m, randomness.child(rng, "turns"))
    ids = np.arange(first_id, first_id + len(poses), dtype=np.uint32)
    yield shapes, placements_by_shape(first, shape_of, of_layer.semantic_ids, poses, ids)
    if covered.land is None or not len(ids):
        return
    things = ThingsOnStage(shapes, first, poses, shape_of)
    block = IdBlock(first_id + len(ids), MOST_BEYOND, NO_OVERFLOW)
    around = GroundAround(ground, covered.land)
    beyond = randomness.child(rng, "beyond")
    thinned, placements = plants_beyond(
        group, things, block, around, material, beyond, first + len(shapes), covered.water_beyond
    )
    yield thinned, [replace(each, semantic_ids=of_layer.semantic_ids) for each in placements]


def _as_group(layer: TerrainLayer, tuft: Tuft) -> GroupConfig:
    """Return a group that stands on the ground as the grass of a layer does."""
    return GroupConfig(
        name="grass",
        label=layer.label,
        semantic_id=layer.semantic_ids[0],
        shape="meadow",
        count=(0, 0),
        size_m=tuft.width_m,
        density=(LayerDensity(kind="layer", label=layer.label),),
        max_slope_deg=50.0,
    )
