"""Shader nodes of clouds before the sky: a picture of all directions above the horizon."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.environment.clouds.dome import (
    ROWS,
    air_before_clouds,
    cloud_image,
)
from oaisys_core.render.blender.materials.images import new_image
from oaisys_core.render.blender.materials.nodes import NodeTree, Socket
from oaisys_core.scene.sky import Sky


class CloudPicture:
    """The picture of a sky's clouds in Blender; it is kept while it stays the same."""

    def __init__(self) -> None:
        self._image: Any = None
        self._pixels: NDArray[np.float32] | None = None

    def set(self, sky: Sky) -> None:
        """Take over the clouds of a sky."""
        pixels = cloud_image(sky) if sky.shows_clouds else None
        if pixels is self._pixels:
            return
        self._image = self._pixels = None
        if pixels is not None:
            self._image = new_image("clouds", pixels, is_float=True, is_color=False)
        self._pixels = pixels

    def along(self, tree: NodeTree, ray: Socket) -> tuple[Socket, Socket]:
        """Return the radiance of clouds along unit vectors, and the share of the sky's there."""
        x, y, up = tree.add("SeparateXYZ", {0: ray}).outputs
        elevation = tree.math("ARCSINE", tree.math("MAXIMUM", up, 0.0))
        row = tree.math("SQRT", tree.math("MULTIPLY", elevation, 2 / pi))
        # Half a texel from the edges, beyond which the picture begins again.
        row = tree.math("MAXIMUM", tree.math("MINIMUM", row, 1 - 0.5 / ROWS), 0.5 / ROWS)
        column = tree.math("DIVIDE", tree.math("ARCTAN2", y, x), 2 * pi)
        place = tree.combine(column, row, 0.0)
        texel = tree.add("TexImage", {"Vector": place}, image=self._image, extension="REPEAT")
        return texel.outputs["Color"], texel.outputs["Alpha"]


def before_sky(
    tree: NodeTree, sky: Sky, clouds: tuple[Socket, Socket], color: Socket, disc: Socket | None
) -> Socket:
    """Return the colour of clouds before a sky of a colour and the sun's disc.

    Args:
        tree: Where nodes are added.
        sky: The sky.
        clouds: What `CloudPicture.along` returns.
        color: Of the sky.
        disc: Of the sun's disc; None if it is not shown.
    """
    radiance, share = clouds
    found = tree.vector("ADD", radiance, tree.scale(color, share))
    if disc is None:
        return found
    # What air before clouds adds is not the sun.
    before = air_before_clouds(sky)
    above = tree.math("MAXIMUM", tree.math("SUBTRACT", share, before), 0.0)
    through = tree.math("DIVIDE", above, 1 - before)
    return tree.vector("ADD", found, tree.scale(disc, through))
