"""Draws the broken rock in walls of a stage: pieces of rock that stand out of a height field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.scatter.placement.walls import place_on_walls
from oaisys_core.procedural.scatter.rock_faces import bare_and_ledges, make_rock_face
from oaisys_core.procedural.terrain.processes.exact import smooth
from oaisys_core.scene import Ground, MeshPrototype, Placement, TerrainMaterial
from oaisys_core.scene.objects import FIRST_ROCK_FACE_ID
from oaisys_core.types import FloatArray
from oaisys_core.world.modules.assets.beyond import placements_by_shape

SHAPES = 8
"""Meshes for each layer."""

AROUND_M, LEAST_AROUND = 6.0, 0.05
"""Standard deviation of the distance in which ledges get what covers the ground, and its least
share of that ground."""

MAP_PX = 512
"""Largest size of the grid on which that is looked for."""


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
    faces = _RockFaces(material, first_prototype)
    for index, layer in enumerate(material.layers):
        if not layer.rock_faces:
            continue
        own = randomness.child(rng, f"layer/{index}")
        T_map_object = place_on_walls(index, material, ground, randomness.child(own, "places"))
        if not len(T_map_object):
            continue
        forms = randomness.child(own, "forms")
        shapes = [make_rock_face(f"{layer.label}_face", forms) for _ in range(SHAPES)]
        shape_of = randomness.child(own, "shapes").integers(SHAPES, size=len(T_map_object))
        cover, is_covered = cover_of_ledges(material, T_map_object[:, :2, 3])
        faces.add(index, shapes, T_map_object[~is_covered], shape_of[~is_covered])
        if is_covered.any():
            bare, ledges = zip(*(bare_and_ledges(each) for each in shapes), strict=True)
            faces.add(index, bare, T_map_object[is_covered], shape_of[is_covered])
            faces.add(cover, ledges, T_map_object[is_covered], shape_of[is_covered])
    return faces.prototypes, faces.placements


class _RockFaces:
    """The prototypes and placements of rock faces, as they are added."""

    def __init__(self, material: TerrainMaterial, first_prototype: int) -> None:
        self.prototypes: list[MeshPrototype] = []
        self.placements: list[Placement] = []
        self._material, self._first_prototype = material, first_prototype
        self._looks: dict[int, TerrainMaterial] = {}
        self._next_id = FIRST_ROCK_FACE_ID

    def add(
        self,
        layer: int,
        shapes: Sequence[MeshPrototype],
        T_map_object: FloatArray,
        shape_of: NDArray[np.int64],
    ) -> None:
        """Add instances of shapes that look as a layer; ``shape_of`` are (N,) indices of shapes."""
        if not len(T_map_object):
            return
        if layer not in self._looks:
            look = self._material.of_layer(layer)
            # Ledges are level: seen from the sides, their texture costs three times the nodes.
            is_rock = look.layers[0].rock_faces
            self._looks[layer] = look if is_rock else replace(look, projects_sides=False)
        look = self._looks[layer]
        maps, semantic_ids = look.layers[0].maps, look.layers[0].semantic_ids
        first = self._first_prototype + len(self.prototypes)
        ids = np.arange(self._next_id, self._next_id + len(T_map_object), dtype=np.uint32)
        self.placements += placements_by_shape(first, shape_of, semantic_ids, T_map_object, ids)
        self.prototypes += [replace(each, maps=maps, ground=look) for each in shapes]
        self._next_id += len(T_map_object)


def cover_of_ledges(material: TerrainMaterial, xy_m: FloatArray) -> tuple[int, NDArray[np.bool_]]:
    """Return the layer that lies on ledges of walls, and at which of (N, 2) places it does.

    Of the layers that are no rock themselves, it covers most of the ground around all places.
    """
    loose = [index for index, layer in enumerate(material.layers) if not layer.rock_faces]
    if not loose:
        return 0, np.zeros(len(xy_m), np.bool_)
    around = np.stack([_around(material, index, xy_m) for index in loose])
    heaviest = int(np.argmax(around.sum(axis=1)))
    return loose[heaviest], around[heaviest] >= LEAST_AROUND


def _around(material: TerrainMaterial, layer: int, xy_m: FloatArray) -> FloatArray:
    """Return the (N,) shares that a layer has of the ground around (N, 2) places."""
    mask = material.masks[layer]
    step = -(-max(mask.shape) // MAP_PX)
    x0, y0, x1, y1 = material.extent_m
    texel_m = np.array((x1 - x0, y1 - y0)) * step / mask.shape[::-1]
    shares = smooth(mask[::step, ::step], AROUND_M / float(texel_m.mean()))
    column, row = ((xy_m - (x0, y0)) / texel_m).astype(np.intp).T
    last = np.array(shares.shape) - 1
    return np.asarray(shares[np.clip(row, 0, last[0]), np.clip(column, 0, last[1])])
