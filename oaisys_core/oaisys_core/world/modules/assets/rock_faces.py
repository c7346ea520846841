"""Draws the broken rock in walls of a stage: pieces of rock that stand out of a height field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oaisys_core import randomness
from oaisys_core.procedural.scatter.placement.walls import place_on_walls
from oaisys_core.procedural.scatter.rock_faces import make_rock_face
from oaisys_core.scene import Ground, MeshPrototype, Placement, TerrainMaterial
from oaisys_core.scene.objects import FIRST_ROCK_FACE_ID
from oaisys_core.world.modules.assets.beyond import placements_by_shape

SHAPES = 8
"""Meshes for each layer."""


def has_rock_faces(material: TerrainMaterial) -> bool:
    """Return whether a layer of the ground is rock that breaks."""
    return any(layer.rock_faces for layer in material.layers)


def draw_rock_faces(
    material: TerrainMaterial, ground: Ground, first_prototype: int, rng: np.random.Generator
) -> tuple[list[MeshPrototype], list[Placement]]:
    """Return rock faces of a stage: prototypes, the first of a given index, and placements.

    Args:
        material: Of the ground.
        ground: The stage.
        first_prototype: Index of the first prototype among those of the scene.
        rng: Draws them.
    """
    prototypes: list[MeshPrototype] = []
    placements: list[Placement] = []
    next_id = FIRST_ROCK_FACE_ID
    for index, layer in enumerate(material.layers):
        if not layer.rock_faces:
            continue
        own = randomness.child(rng, f"layer/{index}")
        T_map_object = place_on_walls(index, material, ground, randomness.child(own, "places"))
        if not len(T_map_object):
            continue
        forms, look = randomness.child(own, "forms"), material.of_layer(index)
        shapes = [
            replace(make_rock_face(f"{layer.label}_face", forms), maps=layer.maps, ground=look)
            for _ in range(SHAPES)
        ]
        shape_of = randomness.child(own, "shapes").integers(SHAPES, size=len(T_map_object))
        ids = np.arange(next_id, next_id + len(T_map_object), dtype=np.uint32)
        first = first_prototype + len(prototypes)
        placements += placements_by_shape(first, shape_of, layer.semantic_ids, T_map_object, ids)
        prototypes += shapes
        next_id += len(T_map_object)
    return prototypes, placements
