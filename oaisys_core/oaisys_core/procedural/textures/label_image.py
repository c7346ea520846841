"""Label images of terrain layers: read with a mapping of pixel values, or of a texture's stones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.images import LABEL_IMAGE, read_pixels
from oaisys_core.scene.terrain_material import LabelImage


def load_label_image(
    path: Path, mapping: Mapping[str, Sequence[int]], others: Sequence[int]
) -> LabelImage:
    """Return the labels in an image.

    Args:
        path: A grey image of 8 or 16 bits, or a colour image.
        mapping: Semantic ids from level 0 on by pixel value: a grey value, or ``#rrggbb``.
        others: Ids of all other pixel values, and of levels that an entry does not have.

    Raises:
        InvalidInputError: The image cannot be read, or contains none of the values.
    """
    values, is_color = _values(path)
    levels = max(len(others), *(len(ids) for ids in mapping.values()))
    ids = np.zeros((levels, *values.shape), np.uint16)
    for level, semantic_id in enumerate(others):
        ids[level] = semantic_id
    found = False
    for value, semantic_ids in mapping.items():
        here = values == _number(value, is_color)
        found = found or bool(here.any())
        for level, semantic_id in enumerate(semantic_ids):
            ids[level][here] = semantic_id
    if not found:
        few = ", ".join(_text(value, is_color) for value in np.unique(values)[:8])
        raise InvalidInputError(
            "labels_from", str(path), f"an image with values of the mapping; it has {few}"
        )
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


def _values(path: Path) -> tuple[NDArray[np.int64], bool]:
    """Return (rows, columns) pixel values, and whether they are colours (0xrrggbb)."""
    image = read_pixels(path, LABEL_IMAGE)
    if image.dtype.kind != "u":
        raise InvalidInputError("labels_from", str(path), "a readable image of 8 or 16 bits")
    if image.ndim == 2:
        return np.asarray(image, np.int64), False
    blue, green, red = np.moveaxis(image[..., :3].astype(np.int64), -1, 0)
    return np.asarray(red << 16 | green << 8 | blue, np.int64), True


def _number(value: str, is_color: bool) -> int:
    """Return the key of a mapping as a pixel value, converting between grey and colour."""
    if value.startswith("#"):
        return int(value[1:], 16) if is_color else int(value[1:3], 16)
    return int(value) * 0x010101 if is_color else int(value)


def _text(value: int, is_color: bool) -> str:
    return f"#{value:06x}" if is_color else str(value)
