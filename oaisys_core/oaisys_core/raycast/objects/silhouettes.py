"""The pixels that one object alone would cover, also beyond the edges of the image."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays, project
from oaisys_core.raycast.objects.visible_boxes import BOX_CORNERS
from oaisys_core.types import FloatArray, PinholeIntrinsics

CANVAS = 1
"""How many images' sizes a silhouette goes on at each side, as in BOP's own tool."""

MAX_OUTSIDE_RAYS = 200_000
"""Of one object; a larger region beyond the image is sampled at a distance of several pixels."""

RAYS_AT_A_TIME = 400_000
"""Bounds the memory for rays."""

NEAR_SHARE = 1e-3
"""Least depth of a box's corners, as a share of its size, for its image to be bounded."""

HitTest = Callable[[FloatArray], NDArray[np.bool_]]
"""Returns (R,) whether rays from the camera along (R, 3) directions, in its frame, hit an object.
"""

Region = tuple[int, int, int, int]
"""First and last column, then first and last row, as half-open ranges (left, right, top, bottom).
"""


class Silhouettes:
    """Silhouettes of objects in the image of one camera, through the centres of its pixels."""

    def __init__(self, camera: PinholeIntrinsics) -> None:
        self._camera = camera
        self._size = camera.width_px, camera.height_px
        self._lens_rays = None if camera.is_rectilinear else pixel_rays(camera)

    def pixels(self, corners_m: FloatArray, is_hit: HitTest) -> tuple[FloatArray, FloatArray]:
        """Return the pixels of an object's silhouette, and how many pixels each stands for.

        Pixels outside of the image are those of a canvas that is larger by `CANVAS` images at each
        side; a fisheye has none. Of a lens that distorts, they are counted in its undistorted
        image, and placed where the lens's polynomial holds.

        Args:
            corners_m: (8, 3) corners of a box around the object, in the camera's frame.
            is_hit: Casts rays at it.

        Returns:
            (M, 2) columns and rows, whole numbers, and (M,) weights.
        """
        parts = [(pixels, np.ones(len(pixels))) for pixels in self._inside(corners_m, is_hit)]
        if not self._camera.is_fisheye:
            parts += self._outside(corners_m, is_hit)
        if not parts:
            return np.empty((0, 2)), np.empty(0)
        pixels, weights = zip(*parts, strict=True)
        return np.concatenate(pixels), np.concatenate(weights)

    def _inside(self, corners_m: FloatArray, is_hit: HitTest) -> Iterator[FloatArray]:
        width, height = self._size
        if self._lens_rays is None:
            left, right, top, bottom = _cut(self._region(corners_m), (0, width, 0, height))
            for columns, rows in _grids((left, right, top, bottom), 1):
                yield _placed(columns, rows)[is_hit(self._straight_rays(columns, rows))]
            return
        rows, columns = np.nonzero(_in_cone(self._lens_rays, corners_m))
        for first in range(0, len(rows), RAYS_AT_A_TIME):
            some = slice(first, first + RAYS_AT_A_TIME)
            hit = is_hit(self._lens_rays[rows[some], columns[some]])
            yield _placed(columns[some], rows[some])[hit]

    def _outside(
        self, corners_m: FloatArray, is_hit: HitTest
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        region = self._region(corners_m)
        width, height = self._size
        left, right, top, bottom = region
        is_in_image = left >= 0 and right <= width and top >= 0 and bottom <= height
        if self._lens_rays is None and is_in_image:
            return
        step = int(np.ceil(np.sqrt(max(1.0, _area(region) / MAX_OUTSIDE_RAYS))))
        for columns, rows in _grids(region, step):
            rays = self._straight_rays(columns, rows)
            pixels = _placed(columns, rows)
            if self._lens_rays is not None:
                pixels = np.rint(project(rays, self._camera))
            out = np.isfinite(pixels).all(axis=1) & ~self.is_in_image(pixels)
            out[out] = is_hit(rays[out])
            yield pixels[out], np.full(np.count_nonzero(out), float(step * step))

    def is_in_image(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Return (M,) whether (M, 2) columns and rows are in the image."""
        return np.asarray(((pixels >= 0) & (pixels < self._size)).all(axis=1))

    def _straight_rays(self, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> FloatArray:
        camera = self._camera
        rays = np.ones((len(columns), 3))
        rays[:, 0] = (columns - camera.cx_px) / camera.fx_px
        rays[:, 1] = (rows - camera.cy_px) / camera.fy_px
        return rays

    def _region(self, corners_m: FloatArray) -> Region:
        """Return the part of the canvas where a box can be in the undistorted image."""
        width, height = self._size
        canvas = -CANVAS * width, (1 + CANVAS) * width, -CANVAS * height, (1 + CANVAS) * height
        depth_m = corners_m[:, 2]
        if depth_m.min() <= NEAR_SHARE * np.ptp(corners_m, axis=0).max():
            return canvas
        pixels = corners_m @ self._camera.K.T
        pixels = pixels[:, :2] / pixels[:, 2:]
        # Far outside, whole numbers would overflow.
        low = np.clip(np.floor(pixels.min(axis=0)), -1e9, 1e9).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)), -1e9, 1e9).astype(int) + 1
        return _cut((int(low[0]), int(high[0]), int(low[1]), int(high[1])), canvas)


def box_corners(low_m: FloatArray, high_m: FloatArray) -> FloatArray:
    """Return the (..., 8, 3) corners of boxes, ordered by x, then y, then z."""
    return np.asarray(low_m[..., None, :] + BOX_CORNERS * (high_m - low_m)[..., None, :])


def _cut(region: Region, frame: Region) -> Region:
    left, right = max(region[0], frame[0]), min(region[1], frame[1])
    top, bottom = max(region[2], frame[2]), min(region[3], frame[3])
    return left, max(left, right), top, max(top, bottom)


def _area(region: Region) -> int:
    return (region[1] - region[0]) * (region[3] - region[2])


def _grids(region: Region, step: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the columns and rows of a region's pixels, some rows at a time."""
    left, right, top, bottom = region
    columns = np.arange(left + step // 2, right, step)
    at_once = max(1, RAYS_AT_A_TIME // max(1, len(columns)))
    rows = np.arange(top + step // 2, bottom, step)
    for first in range(0, len(rows) if len(columns) else 0, at_once):
        grid = np.meshgrid(columns, rows[first : first + at_once])
        yield grid[0].ravel(), grid[1].ravel()


def _placed(columns: NDArray[np.int64], rows: NDArray[np.int64]) -> FloatArray:
    return np.column_stack((columns, rows)).astype(np.float64)


def _in_cone(rays: FloatArray, corners_m: FloatArray) -> NDArray[np.bool_]:
    """Return (H, W) whether (H, W, 3) rays may hit the sphere around a box."""
    centre_m = corners_m.mean(axis=0)
    radius_m = np.linalg.norm(corners_m - centre_m, axis=1).max()
    distance_m = float(np.linalg.norm(centre_m))
    if distance_m <= radius_m:
        return np.ones(rays.shape[:2], np.bool_)
    least = np.sqrt(1 - (radius_m / distance_m) ** 2)
    along = rays @ (centre_m / distance_m)
    return np.asarray(along >= (least - 1e-9) * np.linalg.norm(rays, axis=-1))
