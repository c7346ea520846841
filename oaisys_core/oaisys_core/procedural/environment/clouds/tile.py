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
        points, rows = len(x), max(-(-len(x) // LINE), 1)
        places = np.zeros((2, rows * LINE), np.float32)
        for into, coordinate in zip(places, (x, y), strict=True):
            tiles = coordinate * np.float32(1 / self._size)
            tiles -= np.floor(tiles)
            np.multiply(tiles, np.float32(self._size), out=into[:points])
        columns, lines = places.reshape(2, rows, LINE)
        found = cv2.remap(self._image, columns, lines, cv2.INTER_LINEAR)
        return np.asarray(found.reshape(rows * LINE, *found.shape[2:])[:points])
