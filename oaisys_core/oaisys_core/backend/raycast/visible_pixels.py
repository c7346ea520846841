"""Which pixels of a camera may see one of many boxes: rays elsewhere need not be cast at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import PlacedCamera
from oaisys_core.types import FloatArray, PinholeIntrinsics

BOX_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
"""Of a box of size 1: lower and upper x, then y, then z."""

MARGIN_PX = 0.01
"""By which a box is held to reach farther in the image: more than rounding in float32 moves it."""

MAX_BOXES = 5_000
"""Boxes from which on most pixels may see one, and to tell which takes as long as it saves."""

LEAST_AHEAD = 1e-3
"""RayTarget of a box's size that it must be ahead of a camera for its image to be bounded."""


def visible_pixels(
    camera: PlacedCamera, low_m: FloatArray, high_m: FloatArray
) -> NDArray[np.bool_] | None:
    """Return (H, W) whether the ray through a pixel's centre may meet a box; None: any may.

    Args:
        camera: Without distortion.
        low_m, high_m: (N, 3) corners of boxes along the axes of ``map``.
    """
    if len(low_m) > MAX_BOXES:
        return None
    pinhole, T = camera.intrinsics, camera.T_map_camera
    low_m, high_m = low_m - T[:3, 3], high_m - T[:3, 3]
    size_m = high_m - low_m
    near = np.flatnonzero(_reach_into(pinhole, (low_m + high_m) / 2 @ T[:3, :3], size_m))
    low_m, size_m = low_m[near].astype(np.float32), size_m[near].astype(np.float32)
    corners = low_m[:, None] + BOX_CORNERS.astype(np.float32) * size_m[:, None]
    corners = corners @ T[:3, :3].astype(np.float32)
    depth_m = corners[..., 2]
    is_ahead = depth_m.min(axis=1) > LEAST_AHEAD * size_m.max(axis=1)
    focal_px = np.array((pinhole.fx_px, pinhole.fy_px), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = corners[..., :2] / depth_m[..., None] * focal_px
    pixels += np.array((pinhole.cx_px, pinhole.cy_px), np.float32)
    size_px = (pinhole.width_px, pinhole.height_px)
    first = np.clip(np.ceil(pixels.min(axis=1) - MARGIN_PX), 0, size_px)
    end = np.clip(np.floor(pixels.max(axis=1) + MARGIN_PX) + 1, 0, size_px)
    first[~is_ahead], end[~is_ahead] = 0, size_px
    return _covered(first.astype(np.intp), end.astype(np.intp), size_px)


def _reach_into(
    pinhole: PinholeIntrinsics, middle_m: FloatArray, size_m: FloatArray
) -> NDArray[np.bool_]:
    """Return (N,) whether the spheres around boxes reach into what a camera sees.

    Args:
        pinhole: The camera.
        middle_m: (N, 3) of the boxes, in its optical frame.
        size_m: (N, 3) edges, along any axes.
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


def _covered(
    first: NDArray[np.intp], end: NDArray[np.intp], size_px: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return (H, W) what (N, 2) rectangles of columns and rows cover, ends not included."""
    width, height = size_px
    # Summed along both axes, a corner where a rectangle begins counts all that follows it.
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
