"""Shader nodes that hide the repetition of textures, see `oaisys_core.scene.tiling`."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.scene.tiling import CRISPNESS, SHIFTS, StochasticTiling, Tiling, VoronoiTiling


class TextureLookup(NamedTuple):
    """One of the texture lookups that are blended at a point of the ground.

    Attributes:
        place: Texture coordinates.
        weight: Blending weight.
        angle: Rotation of the texture; None: none.
    """

    place: Socket
    weight: Socket = 1.0
    angle: Socket | None = None


class TilingNodes:
    """Adds the nodes of tilings to a tree.

    ``tables`` holds one image per table, by its identity, and may be shared between trees.
    """

    def __init__(self, tree: NodeTree, tables: dict[int, Any]) -> None:
        self._tree = tree
        self._tables = tables

    def lookups(self, tiling: Tiling, place: Socket) -> list[TextureLookup]:
        """Return the lookups to blend at a point; ``place`` is its position in tiles."""
        if isinstance(tiling, VoronoiTiling):
            return self._voronoi(tiling, place)
        if isinstance(tiling, StochasticTiling):
            return self._stochastic(tiling, place)
        return [TextureLookup(place)]

    def _voronoi(self, tiling: VoronoiTiling, place: Socket) -> list[TextureLookup]:
        tree = self._tree
        at = tree.scale(place, 1.0 / tiling.period_tiles)
        moves = self._lookup(tiling.moves, at, "Closest")
        weight = self._lookup(tiling.weights, at, "Linear")
        angle, shift_u, shift_v = tree.add("SeparateColor", {"Color": moves}).outputs
        weight = tree.component(weight, 0)
        turned = tree.add(
            "VectorRotate", {"Vector": place, "Angle": angle}, rotation_type="Z_AXIS"
        ).outputs[0]
        moved = tree.vector("ADD", turned, tree.combine(shift_u, shift_v, 0.0))
        return [
            TextureLookup(moved, weight, angle),
            TextureLookup(place, tree.math("SUBTRACT", 1.0, weight)),
        ]

    def _stochastic(self, tiling: StochasticTiling, place: Socket) -> list[TextureLookup]:
        # Vectors where they do: Cycles compares each node of a material with all of its kind.
        tree = self._tree
        per_tile = 1.0 / tiling.cell_tiles
        x = tree.dot(place, (per_tile, -per_tile / sqrt(3), 0.0))
        y = tree.dot(place, (0.0, per_tile * 2 / sqrt(3), 0.0))
        skewed = tree.combine(x, y, 0.0)
        corner, inside = tree.vector("FLOOR", skewed), tree.vector("FRACTION", skewed)
        rest = tree.math("SUBTRACT", 1.0, tree.dot(inside, (1.0, 1.0, 0.0)))
        is_upper = tree.math("LESS_THAN", rest, 0.0)
        beyond = tree.math("MULTIPLY", is_upper, rest)
        more = tree.combine(beyond, beyond, tree.math("ABSOLUTE", rest))
        shares = tree.vector("ADD", inside, more)
        powers = shares
        for _ in range(CRISPNESS - 1):
            powers = tree.vector("MULTIPLY", powers, shares)
        total = tree.dot(powers, (1.0, 1.0, 1.0))
        weights = tree.scale(powers, tree.math("DIVIDE", 1.0, total))
        first, second, third = tree.add("SeparateXYZ", {0: weights}).outputs
        centre = (0.5 / SHIFTS, 0.5 / SHIFTS, 0.0)
        texel = tree.vector("MULTIPLY_ADD", corner, 1 / SHIFTS, centre)
        step = tree.math("MULTIPLY", is_upper, 1 / SHIFTS)
        steps = tree.combine(step, step, 0.0), (1 / SHIFTS, 0.0, 0.0), (0.0, 1 / SHIFTS, 0.0)
        lookups = []
        for step_in_table, weight in zip(steps, (third, first, second), strict=True):
            at = tree.vector("ADD", texel, step_in_table)
            shift = self._lookup(tiling.shifts, at, "Closest")
            lookups.append(TextureLookup(tree.vector("ADD", place, shift), weight))
        return lookups

    def _lookup(self, table: NDArray[np.float32], at: Socket, interpolation: str) -> Socket:
        """Return the colour of a table with up to three values per texel, row 0 at v = 0."""
        if id(table) not in self._tables:
            values = table.reshape(*table.shape[:2], -1)
            pixels = np.ones((*values.shape[:2], 4), np.float32)
            pixels[..., : values.shape[2]] = values
            image = new_image("tiling", pixels, is_float=True, is_color=False)
            self._tables[id(table)] = image
        image = self._tables[id(table)]
        node = self._tree.add("TexImage", {"Vector": at}, image=image, interpolation=interpolation)
        return node.outputs["Color"]
