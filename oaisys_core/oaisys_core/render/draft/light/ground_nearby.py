"""How much of the ground nearby points see, and how much light of the sun it gets."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.view import View
from oaisys_core.render.draft.appearance import Floats

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
    np.copyto(there, below, where=~is_ground)
    return there


def light_around(view: View, facing: Floats, sun_share: Floats) -> Floats:
    """Return (H, W) how much of the sun's light surfaces nearby in the picture get.

    Args:
        view: What is seen.
        facing: (H, W) cosines of the sun's angle to the surfaces.
        sun_share: (H, W) share of the sun's disc that they see.
    """
    is_ground = view.is_ground.astype(np.float32)
    light = np.maximum(facing, 0)
    light *= sun_share
    light *= is_ground
    size = max(view.depth_m.shape[1] // AROUND_SHARE, 3)
    # Where hardly any ground is nearby, as in the rest of the picture.
    mean = np.float32(light.mean() / max(is_ground.mean(), 1e-6))
    lit = cv2.blur(light, (size, size))
    little = np.float32(0.02)
    lit += little * mean
    lit /= cv2.blur(is_ground, (size, size)) + little
    return np.asarray(lit)
