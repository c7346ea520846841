"""One view made ready for fusion: what its pixels say, and which blocks they say it about."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import invert
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_mapping.voxels.blocks import BLOCK_VOXELS, Coordinates

FACING_STEP = 0.2
"""Greatest share by which neighbouring depths differ on one surface, for its direction."""

UNKNOWN_M = -1e9
"""Depth of pixels that tell nothing: every voxel is far behind it. Not NaN, which spreads."""

COARSE_BLOCKS = 8
"""Edge of the cells among which free blocks are looked for first."""

LEAST_COSINE = 0.05
"""Of the angle between ray and surface normal, as far as weights go."""


@dataclass(frozen=True)
class PaddedImages:
    """A view's images, flat and with a border of one pixel that says nothing.

    A voxel's pixel is the one whose centre is nearest; all that fall outside are sent to the
    border, so that no voxel needs a question of its own.

    Attributes:
        stride: Pixels of a row, border included.
        rows: Rows, border included.
        depth_m: (rows * stride,) float32; `UNKNOWN_M`: nothing known; ``+inf``: free up to the
            range.
        weight: (rows * stride,) float32; None: 1 everywhere.
        color: (rows * stride,) uint32 whose bytes are red, green, blue and 0; or None.
        labels: (rows * stride,) uint16, or None.
        to_pixel: (3, 3) matrix and (3,) offset that give (u z, v z, z) of points in ``map``, with
            u and v counted from the border's outer edge.
        max_range_m: How far a ray that hit nothing clears.
    """

    stride: int
    rows: int
    depth_m: NDArray[np.float32]
    weight: NDArray[np.float32] | None
    color: NDArray[np.uint32] | None
    labels: NDArray[np.uint16] | None
    to_pixel: tuple[FloatArray, FloatArray]
    max_range_m: float

    @property
    def free_m(self) -> NDArray[np.float32]:
        """(H, W) depth up to which each ray is known to be free; 0: not at all."""
        return np.clip(self.inner(self.depth_m), 0, np.float32(self.max_range_m))

    def inner(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return one of the images as (H, W), without its border."""
        return image.reshape(self.rows, self.stride)[1:-1, 1:-1]

    @property
    def to_map(self) -> tuple[FloatArray, FloatArray]:
        """(3, 3) matrix that gives z times a pixel's (column, row, 1) in `map`, and the camera."""
        matrix, offset = self.to_pixel
        inverse = np.linalg.inv(matrix)
        to_map = inverse.copy()
        to_map[:, 2] += 1.5 * (inverse[:, 0] + inverse[:, 1])
        return to_map, -inverse @ offset


def padded_images(
    depth_m: NDArray[np.float32],
    rgb: NDArray[np.uint8] | None,
    labels: NDArray[np.uint16] | None,
    camera: PinholeIntrinsics,
    T_map_camera: FloatArray,
    *,
    max_range_m: float,
    weighting: str,
    by_incidence: bool,
    clears: bool,
) -> PaddedImages:
    """Return a view made ready; see `PaddedImages` and `TsdfConfig`."""
    with np.errstate(invalid="ignore"):
        is_near = (depth_m > 0) & (depth_m < max_range_m)
        is_beyond = depth_m >= max_range_m
    told = np.where(is_near, depth_m, np.float32(UNKNOWN_M))
    if clears:
        told[is_beyond] = np.inf
    weight = None
    if weighting != "constant" or by_incidence:
        weight = _weights(np.where(is_near, depth_m, max_range_m), camera, weighting, by_incidence)
        weight = _bordered(weight, 0)
    K = camera.K
    K[:2, 2] += 1.5  # half a pixel makes truncation rounding; one is the border
    T_camera_map = invert(T_map_camera)
    return PaddedImages(
        stride=camera.width_px + 2,
        rows=camera.height_px + 2,
        depth_m=_bordered(told.astype(np.float32), UNKNOWN_M),
        weight=weight,
        color=None if rgb is None else _bordered_color(rgb),
        labels=None if labels is None else _bordered(labels, 0),
        to_pixel=(K @ T_camera_map[:3, :3], K @ T_camera_map[:3, 3]),
        max_range_m=max_range_m,
    )


def _weights(
    depth_m: NDArray[Any], camera: PinholeIntrinsics, weighting: str, by_incidence: bool
) -> NDArray[np.float32]:
    weight = np.ones_like(depth_m) if weighting == "constant" else 1 / np.square(depth_m)
    if by_incidence:
        weight = weight * _facing(depth_m, camera)
    return weight.astype(np.float32)


def _facing(depth_m: NDArray[Any], camera: PinholeIntrinsics) -> NDArray[Any]:
    """Return (H, W) cosines between ray and surface normal; least where depth jumps."""
    v, u = np.indices(depth_m.shape)
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    points_m = np.stack((x * depth_m, y * depth_m, depth_m), axis=-1)
    along_v, along_u = np.gradient(points_m, axis=(0, 1))
    normals = np.cross(along_u, along_v)
    length = np.linalg.norm(normals, axis=-1) * np.sqrt(x**2 + y**2 + 1)
    cosine = np.abs(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2])
    cosine /= np.maximum(length, 1e-30)
    jump_m = np.maximum(np.abs(along_u[..., 2]), np.abs(along_v[..., 2]))
    cosine[jump_m > FACING_STEP * depth_m] = LEAST_COSINE
    return np.asarray(np.maximum(cosine, LEAST_COSINE))


def _bordered(image: NDArray[Any], value: float) -> NDArray[Any]:
    return np.pad(image, 1, constant_values=value).ravel()


def _bordered_color(rgb: NDArray[np.uint8]) -> NDArray[np.uint32]:
    height, width, _ = rgb.shape
    bordered = np.zeros((height + 2, width + 2, 4), np.uint8)
    bordered[1:-1, 1:-1, :3] = rgb
    return bordered.view(np.uint32).ravel()


class FreeSpace:
    """Tells which blocks a view's rays pass through, from a pyramid of depths.

    As in hierarchical z-buffering (Greene, Kass and Miller, SIGGRAPH 1993): a block's box in the
    image is held against the extreme depth of at most four cells of the level that is as coarse as
    the box is large.
    """

    def __init__(self, seen: PaddedImages, voxel_size_m: float) -> None:
        free_m = seen.free_m
        self._height, self._width = free_m.shape
        self._last = np.array((self._width - 1, self._height - 1))
        self._edge_m = BLOCK_VOXELS * voxel_size_m
        self._matrix, self._offset = seen.to_pixel
        self._far = _pyramid(free_m, np.maximum, 0.0)

    @cached_property
    def _near(self) -> list[NDArray[Any]]:
        return _pyramid(self._far[0], np.minimum, np.inf)

    def touched(self, blocks: Coordinates, scale: int = 1) -> NDArray[np.bool_]:
        """Return (N,) whether rays may reach into each of (N, 3) blocks.

        Args:
            blocks: Or cells, counted in their own size.
            scale: A cell's edge in blocks.
        """
        edge_m = scale * self._edge_m
        touched = self._in_frustum(blocks, edge_m)
        nearest_m, _, low, high = self._boxes(blocks[touched], edge_m)
        is_inside = (low <= self._last).all(axis=1) & (high >= 0).all(axis=1)
        depth_m = self._extreme(self._far, np.maximum, low, high)
        touched[touched] = is_inside & (depth_m > nearest_m)
        return touched

    def free(self, blocks: Coordinates) -> NDArray[np.bool_]:
        """Return (N,) whether all of each block is in the image and in front of what it shows."""
        free = self._in_frustum(blocks, self._edge_m)
        nearest_m, farthest_m, low, high = self._boxes(blocks[free], self._edge_m)
        is_inside = (low >= 0).all(axis=1) & (high <= self._last).all(axis=1) & (nearest_m > 0)
        depth_m = self._extreme(self._near, np.minimum, low, high)
        free[free] = is_inside & (depth_m > farthest_m)
        return free

    def free_blocks(self) -> Coordinates:
        """Return the (N, 3) blocks that are `free`, found from coarse cells to fine ones."""
        inverse = np.linalg.inv(self._matrix)
        far_m = float(self._far[-1].max())
        pixels = [(u, v) for u in (1, self._width + 1) for v in (1, self._height + 1)]
        corners_m = [inverse @ (far_m * np.array((u, v, 1.0)) - self._offset) for u, v in pixels]
        corners_m.append(inverse @ -self._offset)
        cell_m = COARSE_BLOCKS * self._edge_m
        low, high = (
            np.floor(bound / cell_m).astype(int)
            for bound in (np.min(corners_m, axis=0), np.max(corners_m, axis=0))
        )
        cells = _grid(low, high + 1)
        cells = cells[self.touched(cells, COARSE_BLOCKS)]
        within = _grid(np.zeros(3, int), np.full(3, COARSE_BLOCKS))
        blocks = (cells[:, None] * COARSE_BLOCKS + within).reshape(-1, 3).astype(np.int32)
        return blocks[self.free(blocks)]

    def _in_frustum(self, blocks: Coordinates, edge_m: float) -> NDArray[np.bool_]:
        """Return (N,) which blocks are not wholly beyond one side of the view's pyramid."""
        u, v, z = np.column_stack((self._matrix, self._offset))
        width, height = self._width + 2, self._height + 2
        far = np.array((0, 0, 0, float(self._far[-1].max()))) - z
        sides = np.stack((u, width * z - u, v, height * z - v, z, far))
        half_m = edge_m / 2
        reach_m = half_m * np.abs(sides[:, :3]).sum(axis=1)
        ahead_m = (edge_m * blocks + half_m) @ sides[:, :3].T + sides[:, 3]
        return np.asarray((ahead_m >= -reach_m).all(axis=1))

    def _boxes(self, blocks: Coordinates, edge_m: float) -> tuple[FloatArray, FloatArray, Any, Any]:
        """Return each block's least and greatest depth and its box of pixels, ends included.

        A block that reaches behind the camera has the whole image as its box, or none of it.
        """
        corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        base = (edge_m * blocks) @ self._matrix.T + self._offset
        around = (edge_m * corners) @ self._matrix.T
        u, v, z = (base[:, None, i] + around[None, :, i] for i in range(3))
        nearest_m, farthest_m = z.min(axis=1), z.max(axis=1)
        is_ahead = nearest_m > 1e-3
        depth_m = np.where(is_ahead[:, None], z, 1.0)
        low, high = (
            np.column_stack([extreme(axis / depth_m, axis=1) for axis in (u, v)])
            for extreme in (np.min, np.max)
        )
        low, high = (np.clip(np.floor(a), -1, self._last + 3).astype(int) - 1 for a in (low, high))
        low[~is_ahead], high[~is_ahead] = 0, self._last
        high[farthest_m <= 0] = -1
        return nearest_m, farthest_m, low, high

    def _extreme(self, pyramid: list[NDArray[Any]], which: Any, low: Any, high: Any) -> Any:
        low, high = np.clip(low, 0, self._last), np.clip(high, 0, self._last)
        size = np.maximum(high - low, 1).max(axis=1)
        level = np.clip(np.ceil(np.log2(size)).astype(int), 0, len(pyramid) - 1)
        found = np.empty(len(low))
        for each in np.unique(level):
            here = level == each
            (u0, v0), (u1, v1) = (low[here] >> each).T, (high[here] >> each).T
            cells = pyramid[each]
            found[here] = which(
                which(cells[v0, u0], cells[v0, u1]), which(cells[v1, u0], cells[v1, u1])
            )
        return found


def _grid(low: NDArray[Any], high: NDArray[Any]) -> Coordinates:
    """Return all (N, 3) whole places from ``low`` up to, not including, ``high``."""
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    grid = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([axis.ravel() for axis in grid]).astype(np.int32)


def _pyramid(image: NDArray[np.float32], which: Any, nothing: float) -> list[NDArray[Any]]:
    """Return an image and ever coarser ones, each pixel the extreme of four."""
    levels = [image]
    while max(levels[-1].shape) > 1:
        last = levels[-1]
        pads = [(0, size % 2) for size in last.shape]
        last = np.pad(last, pads, constant_values=nothing)
        rows = which(last[0::2], last[1::2])
        levels.append(which(rows[:, 0::2], rows[:, 1::2]))
    return levels
