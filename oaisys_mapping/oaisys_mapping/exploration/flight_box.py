"""The box over a stage in which a vehicle flies."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from oaisys_core.types import FloatArray
from oaisys_mapping.exploration.occupancy_map import Bounds

HEADROOM_M = 6.0
"""Height of the box above the highest ground."""

PROBES = 64
"""Number of positions along an edge of the stage at which heights are queried."""


def flight_box(extent_m: Sequence[float], height_m: Callable[[FloatArray], FloatArray]) -> Bounds:
    """Return the box over a stage, from its lowest ground to well above its highest.

    Args:
        extent_m: (min_x, min_y, max_x, max_y) of the stage.
        height_m: Gives the (N,) heights of the surface at (N, 2) points.
    """
    low_m, high_m = np.array(extent_m[:2]), np.array(extent_m[2:])
    shares = (np.arange(PROBES) + 0.5) / PROBES
    x_m, y_m = np.meshgrid(
        *(low + shares * (high - low) for low, high in zip(low_m, high_m, strict=True))
    )
    heights_m = height_m(np.column_stack((x_m.ravel(), y_m.ravel())))
    lowest_m, highest_m = float(np.nanmin(heights_m)), float(np.nanmax(heights_m))
    return Bounds(np.append(low_m, lowest_m), np.append(high_m, highest_m + HEADROOM_M))
