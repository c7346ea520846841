"""What shading needs to know of surface points, whatever they lie on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


class Appearance(NamedTuple):
    """How N points of a surface look; all arrays are float32.

    Attributes:
        albedo: (N, 3) linear.
        normal: (N, 3) unit normals in ``map``, bent by the relief of textures.
        smooth: (N, 3) unit normals of the surface itself, interpolated between its vertices.
        roughness: (N,) from 0 to 1, see `diffuse`.
        through: (N,) share of scattered light that leaves on the other side; 0 for most things.
    """

    albedo: Floats
    normal: Floats
    smooth: Floats
    roughness: Floats
    through: Floats


def normalise(vectors: Floats) -> Floats:
    """Return (N, 3) vectors of length 1; zero vectors stay zero."""
    square = np.einsum("ij,ij->i", vectors, vectors)
    return np.asarray(vectors / np.sqrt(np.maximum(square, np.float32(1e-24)))[:, None])
