"""Albedo where a pixel of the ground spans several patches, of which a sample sees one.

Seen at a slant, the next row of pixels may be tens of metres farther away than the one before it.
Where patches of the ground's layers are narrower, few samples per pixel see one layer or another by
chance, which no denoiser removes, as it is given light without albedo. Nor do mip maps of the
masks: they are as blurred across the line of sight as along it. So neighbours share samples there,
and where a pixel is nearly as wide as a patch, as in small pictures.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

MOST_SAMPLES = 4
"""Samples per pixel up to which neighbours share them: of six, the picture is nearer to that of
many samples without."""

SPANNED = 0.5, 1.5
"""Patches from one row to the next from which on albedo is shared, and at which it is in full."""

WIDE = 0.25, 0.75
"""The same for the width of a pixel: it has patches on all its sides."""

SHARED, SHARED_OF_MORE = 0.7, 0.5
"""How much a pixel takes of what its neighbours have seen, with a single sample per pixel, and with
more, which have less noise."""

ACROSS, ALONG = np.full(5, 0.2, np.float32), np.array([0.2, 0.6, 0.2], np.float32)
"""Weights of neighbours at about the same distance, and of those nearer and farther."""


class Patches(NamedTuple):
    """How large the ground's patches are, compared with pixels.

    Attributes:
        width_m: Width of a patch of one layer.
        pixel_rad: Angle of a pixel.
    """

    width_m: float
    pixel_rad: float


def share_albedo(
    albedo: Image, depth_m: Image, is_ground: NDArray[np.bool_], patches: Patches, samples: int
) -> tuple[Image, Image]:
    """Return albedo that neighbours share where patches are narrow, and how far they do.

    Args:
        albedo: (H, W, 3) that few samples have seen.
        depth_m: (H, W) distances, along z or along rays.
        is_ground: (H, W) pixels that show ground.
        patches: How large they are.
        samples: Samples per pixel that have seen it.

    Returns:
        (H, W, 3) albedo, and (H, W, 1) shares of it, 0 where it is what was given.
    """
    most = np.zeros((*depth_m.shape, 1), np.float32)
    in_full = np.float32(SHARED if samples <= 1 else SHARED_OF_MORE)
    wide = _between(WIDE, depth_m * np.float32(patches.pixel_rad / patches.width_m))
    for axis in (0, 1):
        spanned = np.maximum(wide, _spanned(depth_m, patches.width_m, axis))
        share = np.where(is_ground, spanned, np.float32(0))
        if share.any():
            mean = _mean_beside(albedo, share > 0, axis)
            albedo = albedo + in_full * share[..., None] * (mean - albedo)
            most = np.maximum(most, share[..., None])
    return albedo, most


def _spanned(depth_m: Image, width_m: float, axis: int) -> Image:
    """Return (H, W) from 0 to 1 by the patches that a pixel spans along rows or columns.

    The smaller of the steps to both sides counts, so that edges of things are none.
    """
    step = np.abs(np.diff(depth_m, axis=axis))
    last = np.full_like(depth_m.take([0], axis), np.inf)
    before = np.concatenate((last, step), axis=axis)
    after = np.concatenate((step, last), axis=axis)
    return _between(SPANNED, np.minimum(before, after) / np.float32(width_m))


def _between(bounds: tuple[float, float], values: Image) -> Image:
    """Return where values are between two bounds, from 0 to 1."""
    low, high = bounds
    return np.asarray(np.clip((values - low) / (high - low), 0, 1), np.float32)


def _mean_beside(albedo: Image, counts: NDArray[np.bool_], axis: int) -> Image:
    """Return the (H, W, 3) mean of those pixels around each that count; 0 where none does."""
    weight = counts.astype(np.float32)
    across, along = (ACROSS, ALONG) if axis == 0 else (ALONG, ACROSS)
    total, share = (
        cv2.sepFilter2D(each, -1, across, along, borderType=cv2.BORDER_REPLICATE)
        for each in (np.ascontiguousarray(albedo) * weight[..., None], weight)
    )
    return np.asarray(total / np.maximum(share, np.float32(1e-6))[..., None], np.float32)
