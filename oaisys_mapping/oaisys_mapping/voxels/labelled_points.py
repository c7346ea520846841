"""The points that a view's labelled pixels show, by the label cells that contain them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.voxels.block_layout import BLOCK_VOXELS
from oaisys_mapping.voxels.padded_images import PaddedImages
from oaisys_mapping.voxels.semantic_fusion import UNLABELLED

SUBGRIDS = ((0, 0), (1, 1))
"""First row and column of the pixels that vote, every second one in every second row each:
together the squares of one colour of a chessboard. All four subgrids would double the time."""

MAX_AREA_FACTOR = 5.0
"""Limit of the factor by which a pixel's area on a slanting surface exceeds that seen face on."""


@dataclass(frozen=True)
class LabelledPoints:
    """Points with labels.

    Attributes:
        cells: (3, N) int32 cells that contain the points, counted from the first of `base_block`.
        base_block: (3,) block of cells.
        labels: (N,) uint16.
        weights: (N,) float32, at most 1: the share of a cell's surface that each pixel covers.
    """

    cells: NDArray[np.int32]
    base_block: NDArray[np.int32]
    labels: NDArray[np.uint16]
    weights: NDArray[np.float32]


def points_with_labels(images: PaddedImages, cell_m: float) -> LabelledPoints | None:
    """Return the points of pixels that have both a label and a depth; None if there are none."""
    matrix, camera_m = images.map_from_pixel
    # Counted from near the camera, so that float32 is exact enough over its range.
    base_block = np.floor(camera_m / (cell_m * BLOCK_VOXELS)).astype(np.int32)
    offset = camera_m / cell_m - BLOCK_VOXELS * base_block.astype(np.float64)
    parts = [
        _points_of(_Subgrid(images, *first), matrix, offset, cell_m, _max_depth_m(matrix, cell_m))
        for first in SUBGRIDS
    ]
    cells, labels, weights = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    return LabelledPoints(cells, base_block, labels, weights) if len(labels) else None


@dataclass(frozen=True)
class _Subgrid:
    """Every second pixel of every second row of a view.

    Attributes:
        row, column: The first pixel: 0 or 1.
    """

    images: PaddedImages
    row: int
    column: int

    def of(self, image: NDArray[Any], below: int = 0, right: int = 0) -> NDArray[Any]:
        """Return a padded image's values at these pixels, or at neighbours of them."""
        row, column = self.row + 1 + below, self.column + 1 + right
        rows, row_px = self.images.rows - 2, self.images.row_px - 2
        padded = image.reshape(self.images.rows, self.images.row_px)
        return padded[row : rows + 1 + below : 2, column : row_px + 1 + right : 2]


def _points_of(
    pixels: _Subgrid, matrix: FloatArray, offset: FloatArray, cell_m: float, max_depth_m: float
) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.float32]]:
    """Return the (3, N) cells, labels and weights of those pixels that have a label and a depth.

    Args:
        pixels: Some of a view's pixels.
        matrix: (3, 3) matrix that maps z (column, row, 1) to ``map`` axes.
        offset: (3,) the camera, in cells.
        cell_m: Edge length of a cell.
        max_depth_m: Depth beyond which pixels are ignored.
    """
    images = pixels.images
    assert images.labels is not None
    depth_m, labels = pixels.of(images.depth_m), pixels.of(images.labels)
    is_valid = (depth_m > 0) & (depth_m < max_depth_m) & (labels != UNLABELLED)
    valid = np.flatnonzero(is_valid)
    cells = np.empty((3, len(valid)), np.int32)
    if not len(valid):
        return cells, labels[is_valid], depth_m[is_valid]
    depth_m = np.where(is_valid, depth_m, np.float32(0))
    along_u, along_v, ahead = (matrix / cell_m).T[:, :, None]
    rows = along_v * (pixels.row + 2 * np.arange(depth_m.shape[0])) + ahead
    columns = along_u * (pixels.column + 2 * np.arange(depth_m.shape[1]))
    rows, columns = rows.astype(np.float32), columns.astype(np.float32)
    for axis in range(3):
        place = rows[axis, :, None] + columns[axis]
        place *= depth_m
        place += np.float32(offset[axis])
        np.rint(place, out=place)
        cells[axis] = _at(place, valid)
    share = _areas_m2(pixels, matrix) * np.float32(4 / len(SUBGRIDS) / cell_m**2)
    weight = np.minimum(share, np.float32(1), out=share)
    if images.weight is not None:
        weight *= pixels.of(images.weight)
    return cells, _at(labels, valid), _at(weight, valid)


def _max_depth_m(matrix: FloatArray, cell_m: float) -> float:
    """Return the depth at which voting pixels are as far apart as cells."""
    size_u, size_v = (float(np.linalg.norm(matrix[:, axis])) for axis in (0, 1))
    return float(cell_m * np.sqrt(len(SUBGRIDS) / 4 / (size_u * size_v)))


def _at(image: NDArray[Any], pixels: NDArray[np.intp]) -> NDArray[Any]:
    """Return an image's values at some of its pixels, which often are all."""
    return image.ravel() if len(pixels) == image.size else image.ravel()[pixels]


def _areas_m2(pixels: _Subgrid, matrix: FloatArray) -> NDArray[np.float32]:
    """Return the (H, W) area of surface that each pixel shows.

    It is the area of the parallelogram of the derivatives of its point by column and row.
    """
    depth_m = pixels.of(pixels.images.depth_m)
    size_u, size_v = (float(np.linalg.norm(matrix[:, axis])) for axis in (0, 1))
    first_x, first_y = matrix[:, 0] @ matrix[:, 2] / size_u, matrix[:, 1] @ matrix[:, 2] / size_v
    columns = pixels.column + 2 * np.arange(depth_m.shape[1])
    rows = pixels.row + 2 * np.arange(depth_m.shape[0])
    x, y = (first_x + size_u * columns).astype(np.float32), (first_y + size_v * rows)[:, None]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        along_u = _depth_step(pixels, 0, 1) / (depth_m * np.float32(size_u))
        along_v = _depth_step(pixels, 1, 0) / (depth_m * np.float32(size_v))
        ahead = 1 + along_u * x + along_v * y.astype(np.float32)
        factor = np.sqrt(along_u**2 + along_v**2 + ahead**2)
        factor = np.fmin(factor, np.float32(MAX_AREA_FACTOR))
        return np.asarray(factor * np.square(depth_m) * np.float32(size_u * size_v))


def _depth_step(pixels: _Subgrid, below: int, right: int) -> NDArray[np.float32]:
    """Return the smaller depth step to the two opposite neighbours: the one on the same surface."""
    depth_m = pixels.images.depth_m
    here = pixels.of(depth_m)
    before, after = here - pixels.of(depth_m, -below, -right), pixels.of(depth_m, below, right)
    after = after - here
    return np.where(np.abs(before) < np.abs(after), before, after)
