"""How an image of radiance differs from a reference, off the edges of shadows and things."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, laplace, maximum_filter, minimum_filter

from oaisys_core.types import FloatArray

EDGE_PX = 2
"""Within it of an edge of a shadow or a thing, pixels are not judged."""
EDGE_SHARE = 0.03
"""Least bend of the inverse depth, relative to it, that is an edge; on planes it does not bend."""


def errors(ours: FloatArray, theirs: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return the figures of two (H, W) images of radiance."""
    judged = pixels_to_judge(theirs)
    reference = theirs["radiance"][judged]
    relative = np.abs(ours[judged] / reference - 1)
    lit = theirs["sun_share"][judged] == 1
    return {
        "sun_p95": float(np.percentile(relative[lit], 95)) if lit.any() else 0.0,
        "mean": float(ours[judged].mean() / reference.mean() - 1),
        "p95": float(np.percentile(relative, 95)),
        "share": float(judged.mean()),
    }


def pixels_to_judge(theirs: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
    """Return the (H, W) pixels that show ground with light, off the edges of shadows and things."""
    share, depth_m = theirs["sun_share"], theirs["depth_m"]
    inverse_m = 1 / depth_m
    size = 2 * EDGE_PX + 1
    edges = maximum_filter(share, size) != minimum_filter(share, size)
    bends = np.abs(laplace(inverse_m)) > EDGE_SHARE * inverse_m
    edges |= binary_dilation(bends | (theirs["is_object"] > 0), iterations=EDGE_PX)
    return np.asarray(~edges & np.isfinite(depth_m) & (theirs["radiance"] > 0))
