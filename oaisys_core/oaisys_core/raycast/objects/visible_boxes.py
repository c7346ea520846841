"""Which pixels of a camera may see any of many boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray, PinholeIntrinsics

BOX_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
"""Corners of the unit box, ordered by x, then y, then z."""

MARGIN_PX = 0.01
"""Added to a box's image on all sides; more than the rounding error in float32."""

MAX_BOXES = 5_000
"""With more boxes, finding the pixels that may see one takes as long as it saves."""

MIN_DEPTH_SHARE = 1e-3
"""Least depth of a box's corners, as a share of its size, for its image to be bounded."""


def visible_pixels(
    camera: PlacedCamera, low_m: FloatArray, high_m: FloatArray
) -> NDArray[np.bool_] | None:
    """Return (H, W) whether the ray through a pixel's centre may hit a box; None: any may.

    Args:
        camera: Without distortion.
        low_m, high_m: (N, 3) corners of boxes aligned with the axes of ``map``.
    """
    if len(low_m) > MAX_BOXES:
        return None
    pinhole, T = camera.intrinsics, camera.T_map_camera
    low_m, high_m = low_m - T[:3, 3], high_m - T[:3, 3]
    size_m = high_m - low_m
    near = np.flatnonzero(_in_frustum(pinhole, (low_m + high_m) / 2 @ T[:3, :3], size_m))
    low_m, size_m = low_m[near].astype(np.float32), size_m[near].astype(np.float32)
    corners = low_m[:, None] + BOX_CORNERS.astype(np.float32) * size_m[:, None]
    corners = corners @ T[:3, :3].astype(np.float32)
    depth_m = corners[..., 2]
    is_ahead = depth_m.min(axis=1) > MIN_DEPTH_SHARE * size_m.max(axis=1)
    focal_px = np.array((pinhole.fx_px, pinhole.fy_px), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = corners[..., :2] / depth_m[..., None] * focal_px
    pixels += np.array((pinhole.cx_px, pinhole.cy_px), np.float32)
    size_px = (pinhole.width_px, pinhole.height_px)
    first = np.clip(np.ceil(pixels.min(axis=1) - MARGIN_PX), 0, size_px)
    end = np.clip(np.floor(pixels.max(axis=1) + MARGIN_PX) + 1, 0, size_px)
    first[~is_ahead], end[~is_ahead] = 0, size_px
    return _cover(first.astype(np.intp), end.astype(np.intp), size_px)


def _in_frustum(
    pinhole: PinholeIntrinsics, middle_m: FloatArray, size_m: FloatArray
) -> NDArray[np.bool_]:
    """Return (N,) whether the bounding spheres of boxes intersect a camera's frustum.

    Args:
        pinhole: The camera.
        middle_m: (N, 3) centres of the boxes, in its optical frame.
        size_m: (N, 3) edge lengths.
    """
    radius_m = np.linalg.norm(size_m, axis=1) / 2
    depth_m = middle_m[:, 2]
    reach = depth_m > -radius_m
    sizes = (pinhole.width_px, pinhole.height_px)
    centres, focals = (pinhole.cx_px, pinhole.cy_px), (pinhole.fx_px, pinhole.fy_px)
    for axis, (size, centre, focal) in enumerate(zip(sizes, centres, focals, strict=True)):
        for edge_px, sign in ((-0.5, 1), (size - 0.5, -1)):
            slope = (edge_px - centre) / focal
            inwards_m = sign * (middle_m[:, axis] - slope * depth_m) / np.hypot(1, slope)
            reach &= inwards_m > -radius_m
    return np.asarray(reach)


def _cover(
    first: NDArray[np.intp], end: NDArray[np.intp], size_px: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return (H, W) which pixels lie in any of (N, 2) rectangles [first, end) of (column, row)."""
    width, height = size_px
    # A summed-area table of the rectangles' corners counts the rectangles at each pixel.
    steps = np.zeros((height + 1) * (width + 1), np.int32)
    for columns, rows, step in (
        (first[:, 0], first[:, 1], 1),
        (end[:, 0], first[:, 1], -1),
        (first[:, 0], end[:, 1], -1),
        (end[:, 0], end[:, 1], 1),
    ):
        np.add.at(steps, rows * (width + 1) + columns, step)
    counts = steps.reshape(height + 1, width + 1).cumsum(axis=0, dtype=np.int32)
    counts = counts.cumsum(axis=1, dtype=np.int32)
    return np.asarray(counts[:height, :width] > 0)
