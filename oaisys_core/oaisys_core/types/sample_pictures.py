"""How the images of a sample are shown to a person: one sheet of pictures, or a table in HTML.

Depth and other distances are grey by their logarithm from the nearest pixel (bright) to the
farthest (dark), and blue where nothing was hit. Ids have a colour each, 0 is black.
Pictures need pillow.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.Image import Image

NOTHING_RGB = (40, 60, 110)
"""Colour of pixels without a finite value."""

COLUMNS = 4
GAP_PX = 4


class ShownFrame(Protocol):
    """What is shown of a frame: see `oaisys_core.types.Frame`."""

    @property
    def sensor(self) -> str:
        """Name of the sensor."""

    @property
    def modality(self) -> str:
        """Name of the kind of image."""

    @property
    def data(self) -> NDArray[Any]:
        """(H, W) or (H, W, channels) pixels."""


def frame_picture(data: NDArray[Any]) -> NDArray[np.uint8]:
    """Return pixels as colours for a person: (H, W, 3) uint8, sRGB.

    Args:
        data: (H, W) or (H, W, channels): 8-bit colours as they are, other integers as ids, floats
            from their least to their greatest finite value.
    """
    if data.dtype == np.uint8:
        channels = data if data.ndim == 3 else data[..., None]
        return np.ascontiguousarray(np.broadcast_to(channels[..., :3], (*data.shape[:2], 3)))
    if data.dtype.kind in "ui" and data.ndim == 2:
        return _id_colors(data)
    return _grey_levels(data.astype(np.float64))


def _id_colors(ids: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a colour for each id; multiplying by odd numbers spreads neighbours over all."""
    mixed = ids.astype(np.uint64)[..., None] * np.array(
        [2654435761, 805459861, 3674653429], np.uint64
    )
    colors = (64 + (mixed >> np.uint64(8)) % np.uint64(192)).astype(np.uint8)
    colors[ids == 0] = 0
    return colors


def _grey_levels(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    channels = values if values.ndim == 3 else values[..., None]
    finite = np.isfinite(channels).all(axis=2)
    picture = np.empty((*values.shape[:2], 3), np.uint8)
    picture[:] = NOTHING_RGB
    if finite.any():
        level = _levels(channels[finite])
        three = np.zeros((len(level), 3), np.uint8)
        three[:, : level.shape[1]] = level[:, :3]
        picture[finite] = level if level.shape[1] == 1 else three
    return picture


def _levels(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return (N, channels) levels from 0 to 255; those of distances fall with their logarithm."""
    is_distance = values.shape[1] == 1 and values.min() > 0
    shown = -np.log(values) if is_distance else values
    low, high = shown.min(), shown.max()
    level = np.rint(255 * (shown - low) / max(high - low, 1e-12))
    return np.asarray(level, np.uint8)


def sheet(frames: Sequence[ShownFrame]) -> NDArray[np.uint8]:
    """Return the pictures of all frames side by side, four in a row: (H, W, 3) uint8.

    Raises:
        ValueError: There is no frame.
    """
    if not frames:
        raise ValueError("the sample has 0 images, at least 1 is expected to show it")
    pictures = [frame_picture(frame.data) for frame in frames]
    height, width = (max(each.shape[axis] for each in pictures) + GAP_PX for axis in (0, 1))
    rows = -(-len(pictures) // COLUMNS)
    canvas = np.full((rows * height, min(len(pictures), COLUMNS) * width, 3), 255, np.uint8)
    for index, each in enumerate(pictures):
        top, left = (index // COLUMNS) * height, (index % COLUMNS) * width
        canvas[top : top + each.shape[0], left : left + each.shape[1]] = each
    return canvas[: canvas.shape[0] - GAP_PX, : canvas.shape[1] - GAP_PX]


def image_of(pixels: NDArray[np.uint8]) -> Image:
    """Return pixels as an image of pillow.

    Raises:
        ImportError: pillow is not installed; it comes with ``oaisys_core[simulator]``.
    """
    from PIL import Image

    return Image.fromarray(pixels)


def html(title: str, frames: Sequence[ShownFrame]) -> str:
    """Return the pictures of all frames with their names and ranges, as notebooks show them."""
    cells = "".join(_cell(frame) for frame in frames)
    return f"<p>{escape(title)}</p><div style='display:flex;flex-wrap:wrap;gap:8px'>{cells}</div>"


def _cell(frame: ShownFrame) -> str:
    buffer = io.BytesIO()
    image_of(frame_picture(frame.data)).save(buffer, "PNG")
    source = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    name = escape(f"{frame.sensor} {frame.modality}: {_range(frame.data)}")
    picture = f"<img style='max-width:320px' alt='{name}' src='{source}'>"
    return f"<figure style='margin:0'>{picture}<figcaption>{name}</figcaption></figure>"


def _range(data: NDArray[Any]) -> str:
    """Return type, size, and for single channels the least and greatest finite value."""
    size = f"{data.dtype} {'×'.join(map(str, data.shape))}"
    finite = data[np.isfinite(data)]
    if data.ndim != 2 or not finite.size:
        return size
    return f"{size}, {finite.min():g} to {finite.max():g}"
