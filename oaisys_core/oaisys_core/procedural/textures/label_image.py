"""Label images of terrain layers: read with a mapping of pixel values, or of a texture's stones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.files.image_formats.image_use import LABEL_IMAGE
from oaisys_core.files.image_formats.label_images import read_label_pixels
from oaisys_core.scene.terrain_material import LabelImage


def load_label_image(
    path: Path, mapping: Mapping[str, Sequence[int]], others: Sequence[int]
) -> LabelImage:
    """Return the labels in an image.

    Args:
        path: A grey image of 8 or 16 bits, or a colour image of 8 bits.
        mapping: Semantic ids from level 0 on by pixel value: a grey value, or ``#rrggbb``.
        others: Ids of all other pixel values, and of levels that an entry does not have.

    Raises:
        InvalidInputError: The image cannot be read, or contains none of the values.
    """
    pixels = read_label_pixels(path, LABEL_IMAGE)
    pixels.check_values(mapping, path, LABEL_IMAGE.field)
    levels = max(len(others), *(len(ids) for ids in mapping.values()))
    ids = np.zeros((levels, *pixels.values.shape), np.uint16)
    for level, semantic_id in enumerate(others):
        ids[level] = semantic_id
    for value, semantic_ids in mapping.items():
        here = pixels.where(value)
        for level, semantic_id in enumerate(semantic_ids):
            ids[level][here] = semantic_id
    return LabelImage(ids)


def label_stones(
    stones: NDArray[np.uint32],
    tile_m: float,
    min_size_m: float,
    ids: Sequence[int],
    others: Sequence[int],
) -> LabelImage:
    """Return the labels of a texture whose larger stones have labels of their own.

    Args:
        stones: (N, N) number of the stone that each pixel shows, 0 for none.
        tile_m: Edge length of a tile.
        min_size_m: Least diameter of the circle that has the area that a stone shows.
        ids: Semantic ids of these stones from level 0 on.
        others: Ids of all else, and of levels that ``ids`` does not have.
    """
    pixel_m = tile_m / len(stones)
    size_m = 2 * np.sqrt(np.bincount(stones.ravel()) / np.pi) * pixel_m
    is_labelled = size_m >= min_size_m
    is_labelled[0] = False
    here = is_labelled[stones]
    by_level = np.zeros((max(len(ids), len(others)), *stones.shape), np.uint16)
    for level, semantic_id in enumerate(others):
        by_level[level] = semantic_id
    for level, semantic_id in enumerate(ids):
        by_level[level][here] = semantic_id
    return LabelImage(by_level)
