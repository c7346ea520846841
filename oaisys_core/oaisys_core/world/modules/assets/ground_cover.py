"""Draws the grass and the stones that layers of the ground bring with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.sections.density import LayerDensity
from oaisys_core.config.sections.groups import GroupConfig
from oaisys_core.procedural.scatter.ids import NO_OVERFLOW, IdBlock
from oaisys_core.procedural.scatter.loose_stones import (
    LOOSE_STONES,
    StonePatch,
    make_stone_patch,
    stone_colors,
)
from oaisys_core.procedural.scatter.placement.ground_cover import (
    cover_places,
    cover_poses,
    tones_at,
)
from oaisys_core.procedural.scatter.plants.swards import SWARDS, Tuft, blade_color, make_tuft
from oaisys_core.procedural.terrain.surroundings.far_ground import GroundAround
from oaisys_core.procedural.terrain.water.beyond_stage import WaterBeyond
from oaisys_core.scene import Ground, MeshPrototype, Placement, TerrainLayer, TerrainMaterial
from oaisys_core.scene.objects import FIRST_COVER_ID
from oaisys_core.scene.surroundings import FarGround
from oaisys_core.types import FloatArray
from oaisys_core.world.modules.assets.beyond import (
    ThingsOnStage,
    placements_by_shape,
    plants_beyond,
)

FORMS = 3
"""Meshes of one kind and colour."""

MOST_BEYOND = 4000
"""Largest number of patches of one kind on the land around the stage."""

GRASSES = frozenset({"grass_tuft", "meadow", "flower_meadow"})
"""Shapes of groups that take the place of a layer's own grass."""


class CoveredGround(NamedTuple):
    """What grass stands on, and stones lie on.

    Attributes:
        stage: The ground.
        material: Of the ground.
        land: Around the stage, if they are on it; else None.
        water_m: Level of the water on the stage; None: there is none.
        water_beyond: On that land.
    """

    stage: Ground
    material: TerrainMaterial
    land: FarGround | None
    water_m: float | None
    water_beyond: WaterBeyond | None


class LayerCover(NamedTuple):
    """A kind of grass or stones on a layer.

    Attributes:
        layer: Index of the layer.
        number: Of the kind among those of the layer.
        kind: Grass or stones.
    """

    layer: int
    number: int
    kind: Tuft | StonePatch


def covers_of_layers(material: TerrainMaterial, groups: Sequence[GroupConfig]) -> list[LayerCover]:
    """Return the grass and stones that layers bring; not the grass that a group replaces."""
    own = {
        label
        for group in groups
        if group.shape in GRASSES
        for density in group.density
        if isinstance(density, LayerDensity)
        for label in density.labels
    }
    covers = []
    for index, layer in enumerate(material.layers):
        grass = () if layer.label in own else SWARDS.get(layer.sward or "", ())
        kinds: tuple[Tuft | StonePatch, ...] = (
            *grass,
            *LOOSE_STONES.get(layer.loose_stones or "", ()),
        )
        covers += [LayerCover(index, number, kind) for number, kind in enumerate(kinds)]
    return covers


def draw_ground_cover(
    covered: CoveredGround,
    covers: Sequence[LayerCover],
    first_prototype: int,
    rng: np.random.Generator,
) -> tuple[list[MeshPrototype], list[Placement]]:
    """Return grass and stones of layers: prototypes, the first of a given index, and placements.

    Args:
        covered: What they are on.
        covers: Their kinds.
        first_prototype: Index of the first prototype among those of the scene.
        rng: Draws them.
    """
    prototypes: list[MeshPrototype] = []
    placements: list[Placement] = []
    next_id = FIRST_COVER_ID
    for cover in covers:
        own = randomness.child(rng, f"{cover.layer}/{cover.number}")
        index = first_prototype + len(prototypes)
        for shapes, placed in _draw_cover(covered, cover, index, next_id, own):
            prototypes += shapes
            placements += placed
            next_id += sum(len(each.instance_ids) for each in placed)
    return prototypes, placements


def _draw_cover(
    covered: CoveredGround, cover: LayerCover, first: int, first_id: int, rng: np.random.Generator
) -> Iterator[tuple[list[MeshPrototype], list[Placement]]]:
    """Yield what there is of one kind on the stage, and on the land around it."""
    material, ground = covered.material, covered.stage
    layer = material.layers[cover.layer]
    places = randomness.child(rng, "places")
    xy_m, sizes_m = cover_places(cover.kind, cover.layer, material, ground, places, covered.water_m)
    tone, factors = tones_at(material, xy_m)
    shapes = _make_shapes(layer, cover.kind, factors, randomness.child(rng, "forms"))
    form = randomness.child(rng, "shapes").integers(FORMS, size=len(xy_m))
    shape_of = np.asarray(tone * FORMS + form, np.int64)
    poses = cover_poses(ground, xy_m, sizes_m, randomness.child(rng, "turns"))
    ids = np.arange(first_id, first_id + len(poses), dtype=np.uint32)
    yield shapes, placements_by_shape(first, shape_of, layer.semantic_ids, poses, ids)
    if covered.land is None or not len(ids):
        return
    things = ThingsOnStage(shapes, first, poses, shape_of)
    block = IdBlock(first_id + len(ids), MOST_BEYOND, NO_OVERFLOW)
    around = GroundAround(ground, covered.land)
    beyond = randomness.child(rng, "beyond")
    group = _as_group(layer, cover.kind)
    thinned, placements = plants_beyond(
        group, things, block, around, material, beyond, first + len(shapes), covered.water_beyond
    )
    yield thinned, [replace(each, semantic_ids=layer.semantic_ids) for each in placements]


def _make_shapes(
    layer: TerrainLayer, kind: Tuft | StonePatch, factors: FloatArray, rng: np.random.Generator
) -> list[MeshPrototype]:
    """Return `FORMS` meshes for each of (T, 3) factors on the colour of the layer's texture."""
    each = np.repeat(factors, FORMS, axis=0)
    if isinstance(kind, StonePatch):
        name, colors = f"{layer.label}_stones", stone_colors(layer.maps)
        return [make_stone_patch(name, kind, colors * factor, rng) for factor in each]
    name, color = f"{layer.label}_grass", blade_color(layer.maps)
    return [make_tuft(name, kind, color * factor, rng) for factor in each]


def _as_group(layer: TerrainLayer, kind: Tuft | StonePatch) -> GroupConfig:
    """Return a group that is on the ground as grass or stones of a layer are."""
    return GroupConfig(
        name="cover",
        label=layer.label,
        semantic_id=layer.semantic_ids[0],
        shape="meadow",
        count=(0, 0),
        size_m=kind.width_m,
        density=(LayerDensity(kind="layer", label=layer.label),),
        max_slope_deg=min(kind.max_slope_deg, 50.0),
    )
