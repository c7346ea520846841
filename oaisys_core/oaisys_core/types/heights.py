"""Heights of the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types.arrays import FloatArray, ShortRepr


@dataclass(frozen=True, repr=False)
class HeightGrid(ShortRepr):
    """Heights at the centres of square cells, in ``map``; NaN where a centre is off the stage.

    Attributes:
        ground_m: (rows, columns) float32 elevation of the ground; row 0 in the south (least y),
            column 0 in the west (least x).
        surface_m: The same of the topmost surface, objects included.
        origin_xy_m: Centre of cell [0, 0].
        spacing_m: Edge of a cell.
    """

    ground_m: NDArray[np.float32]
    surface_m: NDArray[np.float32]
    origin_xy_m: tuple[float, float]
    spacing_m: float


@dataclass(frozen=True, repr=False)
class HeightQuery(ShortRepr):
    """Heights under points; NaN where there is no ground: off a stage that no land surrounds.

    Attributes:
        ground_height_m: (N,) elevation of the ground.
        surface_height_m: (N,) height of the topmost surface, objects included.
        clearance_m: (N,) the point's z minus the surface's height; negative inside the ground.
    """

    ground_height_m: FloatArray
    surface_height_m: FloatArray
    clearance_m: FloatArray
