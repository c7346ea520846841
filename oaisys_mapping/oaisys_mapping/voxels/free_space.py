"""The free space that a view's rays cross: a depth pyramid, and the blocks known to be free."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_layout import (
    BLOCK_VOXELS,
    NO_BLOCKS,
    BlockCoordinates,
    block_keys,
    blocks_of_keys,
)
from oaisys_mapping.voxels.padded_images import PaddedImages

COARSE_BLOCKS = 8
"""Edge, in blocks, of the coarse cells among which free blocks are searched first."""

MAX_FREE_BLOCKS = 2_000_000
"""Free blocks that are remembered, 8 bytes each; those farthest from the camera are forgotten."""


class DepthPyramid:
    """Tells which blocks a view's rays pass through, as a hierarchical z-buffer does.

    A block's bounding box in the image is compared with the extreme depth of at most four pixels of
    the pyramid's level whose pixels are as large as the box (Greene, Kass and Miller, SIGGRAPH
    1993).
    """

    def __init__(self, images: PaddedImages, voxel_size_m: float) -> None:
        self._free_depth_m = images.free_depth_m
        self._height, self._width = self._free_depth_m.shape
        self._last = np.array((self._width - 1, self._height - 1))
        self._block_m = BLOCK_VOXELS * voxel_size_m
        self._matrix, self._offset = images.pixel_from_map

    @cached_property
    def _farthest(self) -> list[NDArray[Any]]:
        return _pyramid(self._free_depth_m, np.maximum, 0.0)

    @cached_property
    def _nearest(self) -> list[NDArray[Any]]:
        return _pyramid(self._free_depth_m, np.minimum, np.inf)

    def touches(self, blocks: BlockCoordinates, scale: int = 1) -> NDArray[np.bool_]:
        """Return (N,) whether rays may reach into each of (N, 3) blocks.

        Args:
            blocks: Blocks, or larger cells in units of their own size.
            scale: A cell's edge in blocks.
        """
        edge_m = scale * self._block_m
        touched = self._in_frustum(blocks, edge_m)
        nearest_m, _, low, high = self._image_boxes(blocks[touched], edge_m)
        is_inside = (low <= self._last).all(axis=1) & (high >= 0).all(axis=1)
        depth_m = self._extreme(self._farthest, np.maximum, low, high)
        touched[touched] = is_inside & (depth_m > nearest_m)
        return touched

    def are_free(self, blocks: BlockCoordinates) -> NDArray[np.bool_]:
        """Return (N,) whether each of (N, 3) blocks lies in the image and before all it shows."""
        free = self._in_frustum(blocks, self._block_m)
        nearest_m, farthest_m, low, high = self._image_boxes(blocks[free], self._block_m)
        is_inside = (low >= 0).all(axis=1) & (high <= self._last).all(axis=1) & (nearest_m > 0)
        depth_m = self._extreme(self._nearest, np.minimum, low, high)
        free[free] = is_inside & (depth_m > farthest_m)
        return free

    def free_blocks(self) -> BlockCoordinates:
        """Return the (N, 3) blocks that `are_free`, searched from coarse cells to single blocks."""
        inverse = np.linalg.inv(self._matrix)
        far_m = float(self._farthest[-1].max())
        pixels = [(u, v) for u in (1, self._width + 1) for v in (1, self._height + 1)]
        corners_m = [inverse @ (far_m * np.array((u, v, 1.0)) - self._offset) for u, v in pixels]
        corners_m.append(inverse @ -self._offset)
        cell_m = COARSE_BLOCKS * self._block_m
        low, high = (
            np.floor(bound / cell_m).astype(int)
            for bound in (np.min(corners_m, axis=0), np.max(corners_m, axis=0))
        )
        cells = _grid(low, high + 1)
        cells = cells[self.touches(cells, COARSE_BLOCKS)]
        within = _grid(np.zeros(3, int), np.full(3, COARSE_BLOCKS))
        blocks = (cells[:, None] * COARSE_BLOCKS + within).reshape(-1, 3).astype(np.int32)
        return blocks[self.are_free(blocks)]

    def _in_frustum(self, blocks: BlockCoordinates, edge_m: float) -> NDArray[np.bool_]:
        """Return (N,) which blocks do not lie wholly beyond one plane of the view's frustum."""
        u, v, z = np.column_stack((self._matrix, self._offset))
        width, height = self._width + 2, self._height + 2
        far = np.array((0, 0, 0, float(self._farthest[-1].max()))) - z
        planes = np.stack((u, width * z - u, v, height * z - v, z, far))
        half_m = edge_m / 2
        reach_m = half_m * np.abs(planes[:, :3]).sum(axis=1)
        ahead_m = (edge_m * blocks + half_m) @ planes[:, :3].T + planes[:, 3]
        return np.asarray((ahead_m >= -reach_m).all(axis=1))

    def _image_boxes(
        self, blocks: BlockCoordinates, edge_m: float
    ) -> tuple[FloatArray, FloatArray, Any, Any]:
        """Return each block's least and greatest depth and its box of pixels, ends included.

        The box of a block that reaches behind the camera is the whole image, or empty.
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
            pixels = pyramid[each]
            found[here] = which(
                which(pixels[v0, u0], pixels[v0, u1]), which(pixels[v1, u0], pixels[v1, u1])
            )
        return found


class FreeBlocks:
    """Blocks that some view saw to be free, remembered although they have no voxels.

    Attributes:
        keys: (N,) sorted `block_keys`.
    """

    def __init__(self, blocks: BlockCoordinates = NO_BLOCKS) -> None:
        self.keys = block_keys(blocks)

    @property
    def blocks(self) -> BlockCoordinates:
        """The (N, 3) blocks."""
        return blocks_of_keys(self.keys)

    def add(self, blocks: BlockCoordinates, camera_block: FloatArray) -> None:
        """Add (N, 3) blocks; where there are too many, keep those nearest to the camera.

        Args:
            blocks: Free blocks.
            camera_block: (3,) the camera's position in units of blocks.
        """
        keys = np.union1d(self.keys, block_keys(blocks))
        if len(keys) > MAX_FREE_BLOCKS:
            distance = np.abs(blocks_of_keys(keys) - camera_block).max(axis=1)
            keys = keys[np.sort(np.argsort(distance, kind="stable")[:MAX_FREE_BLOCKS])]
        self.keys = keys


def _grid(low: NDArray[Any], high: NDArray[Any]) -> BlockCoordinates:
    """Return all (N, 3) integer points from ``low`` up to, not including, ``high``."""
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    grid = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([axis.ravel() for axis in grid]).astype(np.int32)


def _pyramid(image: NDArray[np.float32], which: Any, fill: float) -> list[NDArray[Any]]:
    """Return an image and ever coarser ones, each pixel the extreme of four."""
    levels = [image]
    while max(levels[-1].shape) > 1:
        last = levels[-1]
        pads = [(0, size % 2) for size in last.shape]
        last = np.pad(last, pads, constant_values=fill)
        rows = which(last[0::2], last[1::2])
        levels.append(which(rows[:, 0::2], rows[:, 1::2]))
    return levels
