"""Shadows of clouds on what the pixels of an image show."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.environment.clouds.shadows import cloud_shadows
from oaisys_core.render.draft.appearance import Floats, take
from oaisys_core.scene.sky import Sky
from oaisys_core.types import FloatArray


def shade_by_clouds(sky: Sky, points_m: FloatArray, sun_share: Floats) -> None:
    """Multiply (H, W) shares of sunlight at (H, W, 3) points, in place, by what clouds leave."""
    shadows = cloud_shadows(sky)
    if shadows is None:
        return
    lit = np.flatnonzero(sun_share)
    flat = sun_share.reshape(-1)
    flat[lit] *= shadows.at(take(points_m.reshape(-1, 3), lit))
