"""Images that repeat without a seam, looked up at many points at once."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field

LINE = 512
"""Points in a row of the images that OpenCV is given; it takes no image of a single long row."""


class Tile:
    """A square image, or one with up to four channels, that repeats along both axes."""

    def __init__(self, image: NDArray[np.float32]) -> None:
        self._size = len(image)
        # One more row and column, so that OpenCV need not know of the repetition.
        wrapped = np.empty((self._size + 1, self._size + 1, *image.shape[2:]), np.float32)
        wrapped[:-1, :-1] = image
        wrapped[-1, :-1] = image[0]
        wrapped[:, -1] = wrapped[:, 0]
        self._image = wrapped

    def at(self, x: Field, y: Field) -> NDArray[np.float32]:
        """Return (N, ...) values, interpolated linearly, at (N,) columns and rows of any size."""
        return look_up(self._image, self._inside(x), self._inside(y))

    def _inside(self, texels: Field) -> Field:
        """Return (N,) places on the first tile that show the same."""
        tiles = texels * np.float32(1 / self._size)
        tiles -= np.floor(tiles)
        tiles *= np.float32(self._size)
        return tiles


def look_up(image: NDArray[np.float32], columns: Field, rows: Field) -> NDArray[np.float32]:
    """Return (N, ...) values of an image, interpolated linearly, at (N,) columns and rows."""
    count, lines = len(columns), max(-(-len(columns) // LINE), 1)
    places = np.zeros((2, lines * LINE), np.float32)
    places[0, :count], places[1, :count] = columns, rows
    found = cv2.remap(image, *places.reshape(2, lines, LINE), cv2.INTER_LINEAR)
    return np.asarray(found.reshape(lines * LINE, *found.shape[2:])[:count])
