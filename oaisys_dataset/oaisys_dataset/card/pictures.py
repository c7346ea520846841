"""The pictures of a data card: a sheet of frames, as colour, depth and labels."""

from __future__ import annotations

from collections.abc import Sequence
from colorsys import hsv_to_rgb
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.types import ALBEDO, COLORS, DEPTH, INSTANCE, NORMAL, RADIANCE, RGB, SEMANTIC_0

if TYPE_CHECKING:
    from oaisys_dataset.reader import DatasetSample

COLUMNS = 4
TILE_PX = 240
GAP_PX = 4
GOLDEN = 0.618034
"""Share of the circle of hues between ids that follow each other, so that they differ clearly."""

UNLABELLED = (32, 32, 32)
SHOWN = (RGB, RADIANCE, ALBEDO, DEPTH, SEMANTIC_0, INSTANCE, NORMAL)
"""Modalities in the order in which they are shown below each other."""

MAX_ROWS = 3


def label_color(label_id: int) -> tuple[int, int, int]:
    """Return the colour (red, green, blue) in which a label is shown."""
    if not label_id:
        return UNLABELLED
    value = (0.95, 0.75, 0.55)[label_id % 3]
    red, green, blue = hsv_to_rgb(label_id * GOLDEN % 1.0, 0.55, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def sheet(samples: Sequence[DatasetSample]) -> bytes:
    """Return a JPEG image with the samples side by side, each as up to three pictures."""
    import cv2

    tiles = [_tile(sample) for sample in samples]
    height = max(tile.shape[0] for tile in tiles)
    rows = []
    for first in range(0, len(tiles), COLUMNS):
        row = np.full((height + GAP_PX, COLUMNS * (TILE_PX + GAP_PX), 3), 255, np.uint8)
        for column, tile in enumerate(tiles[first : first + COLUMNS]):
            left = column * (TILE_PX + GAP_PX)
            row[: tile.shape[0], left : left + TILE_PX] = tile
        rows.append(row)
    _, jpeg = cv2.imencode(".jpg", np.vstack(rows)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    return bytes(jpeg)


def _tile(sample: DatasetSample) -> NDArray[np.uint8]:
    import cv2

    shown = [name for name in SHOWN if name in sample.arrays][:MAX_ROWS]
    pictures = []
    for name in shown:
        picture = _picture(name, sample.arrays[name])
        height = max(1, round(TILE_PX * picture.shape[0] / picture.shape[1]))
        how = cv2.INTER_AREA if name in COLORS else cv2.INTER_NEAREST
        pictures.append(cv2.resize(picture, (TILE_PX, height), interpolation=how))
    if not pictures:
        return np.full((TILE_PX, TILE_PX, 3), 255, np.uint8)
    return np.asarray(np.vstack(pictures), np.uint8)


def _picture(modality: str, image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3) colours."""
    if modality in COLORS:
        return np.asarray(image, np.uint8)
    if modality == DEPTH:
        return _depth_picture(image)
    if modality == NORMAL:
        return np.asarray(np.rint((image + 1) * 127.5), np.uint8)
    if modality == RADIANCE:
        white = max(4 * float(image.mean()), 1e-12)
        return encode_srgb(np.clip(image / white, 0, 1))
    ids, places = np.unique(image, return_inverse=True)
    colors = np.array([label_color(int(i)) for i in ids], np.uint8)
    return np.asarray(colors[places.reshape(image.shape)])


def _depth_picture(depth_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return depth from near (red) to far (blue), logarithmically; white where nothing is hit."""
    import cv2

    hit = np.isfinite(depth_m) & (depth_m > 0)
    if not hit.any():
        return np.full((*depth_m.shape, 3), 255, np.uint8)
    logs = np.log(np.where(hit, depth_m, depth_m[hit].max()))
    near, far = logs.min(), logs.max()
    share = (far - logs) / max(float(far - near), 1e-6)
    shown = cv2.applyColorMap(np.rint(255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(hit[..., None], shown, 255).astype(np.uint8)
