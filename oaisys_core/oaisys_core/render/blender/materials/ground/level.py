"""The ground's surface at one level of its textures: layers, mixed by weights and relief."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import e
from typing import Any

from oaisys_core.procedural.textures.borders import (
    MAX_HEIGHT,
    MIN_HEIGHT,
    MIN_WEIGHT,
    NEGLIGIBLE,
    LayerBorder,
    borders,
)
from oaisys_core.render.blender.materials.ground.layer import NUDGE, LayerNodes, MaterialLevel
from oaisys_core.render.blender.materials.ground.layer_weights import CHANNELS, LayerWeights
from oaisys_core.render.blender.materials.nodes import (
    MIX_RESULT,
    NodeTree,
    Socket,
    in_group,
    node_group,
)
from oaisys_core.render.shading.looks import SIDE_BLEND
from oaisys_core.scene.terrain_material import STEEP_COS

NOISE_STEP = 97
"""Multiples of a random number, whose fractions are as good as independent: there are 2^24."""

Axes = tuple[int, int] | None
"""See `Plane.axes`."""


class LevelNodes:
    """Adds nodes for the surface of all layers at one level.

    ``groups`` are node groups that were made before, which the level's other materials share, and
    ``weights`` those of the material's layers, or None with a single one.
    """

    def __init__(
        self,
        tree: NodeTree,
        level: MaterialLevel,
        groups: dict[tuple[Any, ...], Any],
        weights: LayerWeights | None,
    ) -> None:
        self._tree, self._level, self._groups = tree, level, groups
        self._layers, self._weights = level.material.layers, weights

    def surface(self) -> Socket:
        """Return the surface, projected from above and, if the material asks for it, from sides."""
        if not self._level.material.projects_sides:
            return self._project(None)
        tree = self._tree
        normal = tree.add("NewGeometry").outputs["Normal"]
        nx, ny, nz = (
            tree.math("ABSOLUTE", part) for part in tree.add("SeparateXYZ", {0: normal}).outputs
        )
        slope = 1 / (STEEP_COS[0] - STEEP_COS[1])
        steep = tree.clamp("MULTIPLY_ADD", nz, -slope, STEEP_COS[0] * slope)
        turn = tree.clamp("MULTIPLY_ADD", tree.math("SUBTRACT", nx, ny), SIDE_BLEND, 0.5)
        sides = tree.mix(turn, self._project((0, 2)), self._project((1, 2)))
        return tree.mix(steep, self._project(None), sides)

    def _project(self, axes: Axes) -> Socket:
        """Return the surface of all layers, projected onto a plane."""
        return in_group(self._tree, "ground_plane", partial(self._plane_surface, axes))

    def _plane_surface(self, axes: Axes, tree: NodeTree) -> Socket:
        """Return the surface of all layers, projected onto a plane.

        It has the colour of their mixture, and all else of one of them, which is picked at random:
        each as often as it covers the point.
        """
        color, picked = self._mixture(axes, tree)
        color = LayerNodes(tree, self._level, axes).with_variation(color)
        count = len(self._layers)
        surfaces = [self._surface(tree, index, axes, color) for index in range(count)]
        bounds = [index + 0.5 for index in range(count - 1)]
        return tree.by_number(picked, bounds, surfaces, frees_stack=True)

    def _mixture(self, axes: Axes, tree: NodeTree) -> tuple[Socket, Socket]:
        """Return the colour of all layers, and the index of the one that is picked.

        Cycles evaluates whatever it can as early as it can. So that its stack holds the same
        numbers for any count of layers, the coordinates of each depend on the colour of those
        before it, see `NUDGE`.
        """
        nudge: Socket = self._level.nudge(axes, 1)
        if self._weights is None:
            nodes = LayerNodes(tree, self._level, axes)
            return nodes.color_and_height(0, nudge)[0], 0.0
        weights = self._weights.sockets(tree, 0, nudge)
        first = partial(self._first_layer, axes)
        inputs: dict[str | int, Any] = {0: nudge, 1: weights[0]}
        color, key = self._group(tree, ("first", axes), first, inputs, ("Color", "Float"))
        picked: Socket = 0.0
        for index, border in enumerate(self._borders(), start=1):
            number, channel = divmod(index, CHANNELS)
            if channel == 0:
                weights = self._weights.sockets(tree, number, tree.scale(color, NUDGE))
            make = partial(self._with_layer, axes, index, border)
            inputs = {0: color, 1: key, 2: picked, 3: weights[channel]}
            outputs = ("Color", "Float", "Float")
            color, key, picked = self._group(tree, ("layer", index, axes), make, inputs, outputs)
        return color, picked

    def _first_layer(
        self, axes: Axes, tree: NodeTree, nudge: Socket, weight: Socket
    ) -> tuple[Socket, Socket]:
        """Return the colour and the key of the first layer, see `borders`."""
        color, height = LayerNodes(tree, self._level, axes).color_and_height(0, nudge)
        return color, _key(tree, height, weight)

    def _with_layer(
        self,
        axes: Axes,
        index: int,
        border: LayerBorder,
        tree: NodeTree,
        color: Socket,
        below: Socket,
        picked: Socket,
        weight: Socket,
    ) -> tuple[Socket, Socket, Socket]:
        """Return colour, key and picked layer of a layer and those before it."""
        nodes = LayerNodes(tree, self._level, axes)
        texel, height = nodes.color_and_height(index, tree.scale(color, NUDGE))
        above = tree.math("SUBTRACT", _key(tree, height, weight), below)
        side = tree.math("TANH", tree.math("MULTIPLY", above, float(border.slope)))
        factor = tree.clamp("MULTIPLY_ADD", side, float(border.gain), 0.5)
        color = tree.color_mix(factor, color, texel).outputs[MIX_RESULT]
        below = tree.math("MULTIPLY_ADD", above, factor, below)
        both = tree.math("SUBTRACT", factor, tree.math("MULTIPLY", factor, factor))
        below = tree.math("MULTIPLY_ADD", both, float(border.surplus), below)
        is_seen = tree.math("LESS_THAN", _noise(tree, index, factor), factor)
        change = tree.math("SUBTRACT", float(index), picked)
        return color, below, tree.math("MULTIPLY_ADD", change, is_seen, picked)

    def _surface(self, tree: NodeTree, index: int, axes: Axes, color: Socket) -> Socket:
        """Return the surface of a layer of a colour."""

        def make(inner: NodeTree, inner_color: Socket) -> list[Socket]:
            return [LayerNodes(inner, self._level, axes).surface(index, inner_color)]

        return self._group(tree, ("surface", index, axes), make, {0: color}, ("Shader",))[0]

    def _group(
        self,
        tree: NodeTree,
        key: tuple[Any, ...],
        make: Callable[..., Sequence[Socket]],
        inputs: dict[str | int, Any],
        outputs: Sequence[str],
    ) -> Sequence[Socket]:
        """Return the outputs of a node group of the level, which is made at its first use."""
        key = (self._level.finer, *key)
        if key not in self._groups:
            kinds = {"first": ("Vector", "Float"), "surface": ("Color",)}
            self._groups[key] = node_group(
                f"ground_{key[1]}",
                make,
                inputs=kinds.get(key[1], ("Color", "Float", "Float", "Float")),
                outputs=outputs,
            )
        made: Sequence[Socket] = tree.add("Group", inputs, node_tree=self._groups[key]).outputs
        return made

    def _borders(self) -> list[LayerBorder]:
        level = self._level
        seen = [level.level_of(layer.maps, layer.maps.tile_m) for layer in self._layers]
        return borders([level.images.heights(maps).variance for maps in seen])


def _key(tree: NodeTree, height: Socket, weight: Socket) -> Socket:
    """Return the key of a layer, see `borders`."""
    weight = tree.math("MAXIMUM", tree.math("SUBTRACT", weight, NEGLIGIBLE), MIN_WEIGHT)
    # Only differences of keys matter, so all heights may begin at 0.
    span = MAX_HEIGHT - MIN_HEIGHT
    return tree.math("MULTIPLY_ADD", height, span, tree.math("LOGARITHM", weight, e))


def _noise(tree: NodeTree, index: int, factor: Socket) -> Socket:
    """Return a uniform random number from 0 to 1 of a layer, evaluated after its factor.

    All come from one, because each node of noise leaves numbers on Cycles' stack.
    """
    position = tree.add("NewGeometry").outputs["Position"]
    noise = tree.add("TexWhiteNoise", {"Vector": position}).outputs["Value"]
    multiple = tree.math("MULTIPLY_ADD", factor, NUDGE, float(NOISE_STEP * (index + 1)))
    return tree.math("FRACT", tree.math("MULTIPLY", noise, multiple))
