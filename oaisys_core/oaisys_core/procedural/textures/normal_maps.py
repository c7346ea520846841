"""Tangent-space normals as bytes, in which a flat surface is exactly flat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FLAT, STEPS = 128, 127
"""Byte of a component of 0, and how many more stand for 1.

With the usual (byte / 127.5 - 1), no byte would be 0, and a flat surface would lean by 0.3 degrees.
"""


def encode_normals(normals: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return components from -1 to 1 as bytes."""
    return np.asarray(np.rint(normals * np.float32(STEPS) + np.float32(FLAT)), np.uint8)


def decode_normals(normal_gl: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the components that bytes stand for: the inverse of `encode_normals`."""
    return (normal_gl.astype(np.float32) - np.float32(FLAT)) / np.float32(STEPS)
