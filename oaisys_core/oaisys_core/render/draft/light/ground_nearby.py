"""How much of the ground nearby points see, and how much light of the sun it gets."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import View
from oaisys_core.render.draft.appearance import Appearance, Floats
from oaisys_core.scene import Sky

Flags = NDArray[np.bool_]

AROUND_SHARE = 12
"""The light of surfaces nearby is a mean over this part of the picture's width."""


def ground_share(normal: Floats, bend_cos: Floats, free: Floats, is_ground: Flags) -> Floats:
    """Return the (N,) share of their hemisphere in which points see ground below the horizon.

    Objects see level ground there. A slope sees other ground only where that hides something of
    its hemisphere; what a texture bends away from the slope sees this slope.
    """
    half = np.float32(0.5)
    below = (1 - normal[:, 2]) * half
    there = np.minimum(below, (1 - bend_cos) * half + (1 - free))
    return np.where(is_ground, there, below)


def light_around(view: View, look: Appearance, sun_share: Floats, sky: Sky) -> Floats:
    """Return (H, W) how much of the sun's light surfaces nearby in the picture get."""
    is_ground = view.is_ground.astype(np.float32)
    facing = np.maximum(look.smooth @ np.array(sky.to_sun, np.float32), 0)
    size = max(view.depth_m.shape[1] // AROUND_SHARE, 3)
    lit = cv2.blur(facing * sun_share * is_ground, (size, size))
    # Where hardly any ground is nearby, as in the rest of the picture.
    mean = np.float32((facing * sun_share * is_ground).mean() / max(is_ground.mean(), 1e-6))
    little = np.float32(0.02)
    return np.asarray((lit + little * mean) / (cv2.blur(is_ground, (size, size)) + little))
