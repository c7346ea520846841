"""The ground's surface at one level of its textures: layers, mixed by their shares and relief."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from oaisys_core.backend.blender.materials.ground_layer import LayerNodes, MaterialLevel
from oaisys_core.backend.blender.materials.nodes import (
    NodeTree,
    Socket,
    number_group,
    surface_group,
)
from oaisys_core.textures.borders import (
    LEAST_HEIGHT,
    MOST_HEIGHT,
    NEGLIGIBLE,
    LayerBorder,
    borders,
    follows_relief,
)

STEEP_COS = (0.77, 0.57)
"""Vertical component of the normal (40 and 55 degrees of slope) between which the texture projected
from above gives way to those from the sides."""

SIDE_BLEND = 2.5
"""Sharpness of the transition between two sides."""

Axes = tuple[int, int] | None
"""See `Plane.axes`."""


class LevelNodes:
    """Adds nodes for the surface of all layers at one level.

    ``groups`` are node groups that were made before, which the level's other materials share, and
    ``shares_group`` is that of `layer_shares`, or None with a single layer.
    """

    def __init__(
        self,
        tree: NodeTree,
        level: MaterialLevel,
        groups: dict[tuple[Any, ...], Any],
        shares_group: Any,
    ) -> None:
        self._tree, self._level, self._groups = tree, level, groups
        self._layers = level.material.layers
        self._shares: Sequence[Socket] = ()
        if shares_group is not None:
            self._shares = tree.add("Group", node_tree=shares_group).outputs

    def surface(self) -> Socket:
        """Return the surface, projected from above and, if the material asks for it, from sides."""
        if not self._level.material.projects_sides:
            return self._projected(None)
        tree = self._tree
        normal = tree.add("NewGeometry").outputs["Normal"]
        nx, ny, nz = (
            tree.math("ABSOLUTE", part) for part in tree.add("SeparateXYZ", {0: normal}).outputs
        )
        slope = 1 / (STEEP_COS[0] - STEEP_COS[1])
        steep = tree.clamped("MULTIPLY_ADD", nz, -slope, STEEP_COS[0] * slope)
        turn = tree.clamped("MULTIPLY_ADD", tree.math("SUBTRACT", nx, ny), SIDE_BLEND, 0.5)
        sides = tree.mixed(turn, self._projected((0, 2)), self._projected((1, 2)))
        return tree.mixed(steep, self._projected(None), sides)

    def _projected(self, axes: Axes) -> Socket:
        """Return the surface of all layers, projected onto a plane."""
        result, *others = (self._layer(index, axes) for index in range(len(self._layers)))
        for surface, factor in zip(others, self._mix_factors(axes), strict=True):
            result = self._tree.mixed(factor, result, surface)
        return result

    def _layer(self, index: int, axes: Axes) -> Socket:
        def make() -> Any:
            return surface_group(
                "ground_layer",
                lambda tree: LayerNodes(tree, self._level, axes).surface(self._layers[index]),
            )

        return self._group(("surface", index, axes), make)[0]

    def _mix_factors(self, axes: Axes) -> list[Socket]:
        """Return the mix factor of each layer but the first over those before it."""
        tree = self._tree
        if not follows_relief(self._level.material):
            gain = 1 / (1 - 2 * NEGLIGIBLE)
            return [
                tree.clamped("MULTIPLY_ADD", share, gain, -NEGLIGIBLE * gain)
                for share in self._shares
            ]
        below, *keys = self._keys(axes)
        found: list[Socket] = []
        for key, border in zip(keys, self._borders(), strict=True):
            above = tree.math("SUBTRACT", key, below)
            side = tree.math("TANH", tree.math("MULTIPLY", above, float(border.slope)))
            factor = tree.clamped("MULTIPLY_ADD", side, float(border.gain), 0.5)
            found.append(factor)
            below = tree.math("MULTIPLY_ADD", above, factor, below)
            both = tree.math("SUBTRACT", factor, tree.math("MULTIPLY", factor, factor))
            below = tree.math("MULTIPLY_ADD", both, float(border.surplus), below)
        return found

    def _keys(self, axes: Axes) -> list[Socket]:
        """Return the key of each layer, see `borders`; the shares are logarithms of weights."""

        def make() -> Any:
            return number_group(
                "ground_heights",
                lambda tree: [
                    LayerNodes(tree, self._level, axes).height(each) for each in self._layers
                ],
            )

        tree, span = self._tree, MOST_HEIGHT - LEAST_HEIGHT
        # Only differences of keys matter, so all heights may begin at 0.
        return [
            tree.math("MULTIPLY_ADD", height, span, share)
            for height, share in zip(
                self._group(("heights", axes), make), self._shares, strict=True
            )
        ]

    def _borders(self) -> list[LayerBorder]:
        level = self._level
        seen = [level.seen(layer.maps, layer.maps.tile_m) for layer in self._layers]
        return borders([level.images.heights(maps).variance for maps in seen])

    def _group(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Sequence[Socket]:
        """Return the outputs of a node group of the level, which is made at its first use."""
        key = (self._level.finer, *key)
        if key not in self._groups:
            self._groups[key] = make()
        outputs: Sequence[Socket] = self._tree.add("Group", node_tree=self._groups[key]).outputs
        return outputs
