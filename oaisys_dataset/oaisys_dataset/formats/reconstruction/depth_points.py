"""Points of a world's surface from depth images, and the pixels in which they are seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import (
    depth_along_ray_m,
    invert,
    pixel_rays,
    project,
    transform_points,
)
from oaisys_core.types import DEPTH, DEPTH_TRUE, RGB, FloatArray, PinholeIntrinsics

if TYPE_CHECKING:
    from oaisys_dataset.manifest import FrameRecord
    from oaisys_dataset.reader import Dataset

POINTS_PER_VIEW = 2000

POINTS_SEED = 77
"""Beside a world's seed, so that the pixels do not repeat draws of the world itself."""

DEPTH_TOLERANCE = 0.005
"""A point is seen where its depth is within this share of the depths around its pixel."""

EDGE_RATIO = 1.1
"""Where the depths around a pixel differ by more, a point may be behind an edge and is not seen."""

RAY_TOLERANCE_PX = 2.0
"""Distance from a pixel's ray within which a projected point is trusted; far outside of the image
the distortion's polynomial folds points back into it."""


class DepthView(NamedTuple):
    """One view of the world.

    Attributes:
        depth_m: Returns the (H, W) depth, ``+inf`` where nothing was hit.
        rgb: Returns the (H, W, 3) colours.
    """

    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    depth_m: Callable[[], NDArray[np.float32]]
    rgb: Callable[[], NDArray[np.uint8]]


@dataclass(frozen=True)
class DepthPoints:
    """Points with their colours and observations.

    Attributes:
        points_m: (N, 3) in ``map``.
        rgb: (N, 3), of the pixel that a point was drawn from.
        pixels: For each view, (M, 2) pixels of the points that it sees; pixel centres at integers.
        seen: For each view, (M,) rows of ``points_m``.
    """

    points_m: FloatArray
    rgb: NDArray[np.uint8]
    pixels: list[FloatArray]
    seen: list[NDArray[np.int64]]


def world_points(
    dataset: Dataset, frames: Sequence[FrameRecord], points_per_view: int
) -> DepthPoints:
    """Return points of the surface that a world's colour images show."""
    rng = np.random.default_rng([frames[0].world_seed, POINTS_SEED])
    return surface_points([_view(dataset, frame) for frame in frames], points_per_view, rng)


def _view(dataset: Dataset, record: FrameRecord) -> DepthView:
    camera = record.camera

    def image(modality: str) -> NDArray[Any]:
        if modality not in record.images:  # a view without depth, which shows no point
            return np.full((camera.height_px, camera.width_px), np.inf, np.float32)
        return dataset.sample(record, (modality,)).arrays[modality]

    # Points are the true surface, also where a sensor's depth is noisy.
    depth = DEPTH_TRUE if DEPTH_TRUE in record.images else DEPTH
    return DepthView(camera, record.pose, partial(image, depth), partial(image, RGB))


def surface_points(
    views: Sequence[DepthView], points_per_view: int, rng: np.random.Generator
) -> DepthPoints:
    """Draw pixels of each view whose ray hit something, and find the points in all views.

    Only one view's images are in memory at a time; each view's depth is read twice.
    """
    drawn = [_draw_points(view, points_per_view, rng) for view in views]
    points_m = np.concatenate([each.points_m for each in drawn])
    ends = np.cumsum([len(each.points_m) for each in drawn])
    pixels, seen = [], []
    for view, each, end in zip(views, drawn, ends, strict=True):
        own = np.arange(end - len(each.points_m), end)
        others, other_pixels = _visible(view, points_m)
        is_new = (others < own[0]) | (others > own[-1]) if len(own) else np.ones(len(others), bool)
        seen.append(np.concatenate((own, others[is_new])))
        pixels.append(np.concatenate((each.pixels, other_pixels[is_new])))
    return DepthPoints(points_m, np.concatenate([each.rgb for each in drawn]), pixels, seen)


class _Drawn(NamedTuple):
    points_m: FloatArray
    rgb: NDArray[np.uint8]
    pixels: FloatArray


def _draw_points(view: DepthView, count: int, rng: np.random.Generator) -> _Drawn:
    """Return points through the centres of random pixels."""
    depth_m = view.depth_m()
    hits = np.flatnonzero(np.isfinite(depth_m))
    chosen = np.sort(rng.choice(hits, min(count, len(hits)), replace=False))
    rows, columns = np.unravel_index(chosen, depth_m.shape)
    z_m = depth_m[rows, columns].astype(np.float64)
    in_camera_m = pixel_rays(view.intrinsics)[rows, columns] * z_m[:, None]
    pixels = np.column_stack((columns, rows)).astype(np.float64)
    points_m = transform_points(view.T_map_camera, in_camera_m)
    return _Drawn(points_m, view.rgb()[rows, columns], pixels)


def _visible(view: DepthView, points_m: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the rows of points that a view sees, and their pixels."""
    in_camera_m = transform_points(invert(view.T_map_camera), points_m)
    rows = np.flatnonzero(depth_along_ray_m(in_camera_m, view.intrinsics) > 0)
    pixels = project(in_camera_m[rows], view.intrinsics)
    width, height = view.intrinsics.width_px, view.intrinsics.height_px
    inside = ((pixels >= 0) & (pixels <= (width - 1, height - 1))).all(axis=1)
    rows, pixels = rows[inside], pixels[inside]
    is_seen = _agrees(view, in_camera_m[rows], pixels)
    return rows[is_seen], pixels[is_seen]


def _agrees(view: DepthView, in_camera_m: FloatArray, pixels: FloatArray) -> NDArray[np.bool_]:
    """Return which points lie on the surface that the pixels around them show."""
    depth_m = view.depth_m()
    left, up = np.floor(pixels).astype(np.int64).T
    right = np.minimum(left + 1, depth_m.shape[1] - 1)
    down = np.minimum(up + 1, depth_m.shape[0] - 1)
    corners = np.stack([depth_m[v, u] for v in (up, down) for u in (left, right)])
    z_m = depth_along_ray_m(in_camera_m, view.intrinsics)
    near_m, far_m = corners.min(axis=0), corners.max(axis=0)
    on_surface = (z_m >= near_m * (1 - DEPTH_TOLERANCE)) & (z_m <= far_m * (1 + DEPTH_TOLERANCE))
    is_edge = far_m > near_m * EDGE_RATIO
    rays = pixel_rays(view.intrinsics)[up, left]
    off_px = np.abs(in_camera_m / z_m[:, None] - rays) * view.intrinsics.fx_px
    return np.asarray(on_surface & ~is_edge & (off_px.max(axis=1) < RAY_TOLERANCE_PX))
