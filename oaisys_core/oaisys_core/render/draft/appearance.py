"""What shading needs to know of surface points, whatever they lie on.

Arrays of (N, 3) vectors and colours are stored component by component (Fortran's order): NumPy then
works on N values at a time, instead of 3, where it multiplies them by (N, 1) others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import FloatArray

Floats = NDArray[np.float32]

Rows = NDArray[np.intp] | slice
"""Some of N points; those of a slice are not copied."""


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


def zeros(*shape: int) -> Floats:
    """Return zeros of a shape whose last axis is that of components."""
    if len(shape) == 2:
        return np.zeros(shape, np.float32, order="F")
    return np.moveaxis(np.zeros((shape[-1], *shape[:-1]), np.float32), 0, -1)


def empty(count: int, components: int) -> Floats:
    """Return (N, C) values of anything, all of which are to be written."""
    return np.empty((count, components), np.float32, order="F")


def by_component(values: ArrayLike) -> Floats:
    """Return (N, ...) float32 values stored component by component; copied if they are not yet."""
    return np.asarray(values, np.float32, order="F")


def places_m(values: ArrayLike) -> FloatArray:
    """Return the same in float64, as positions need it."""
    return np.asarray(values, np.float64, order="F")


def take(values: NDArray[Any], rows: Rows) -> NDArray[Any]:
    """Return some of (N, ...) values, in the order in which those are stored."""
    if isinstance(rows, slice):
        return values[rows]
    if values.ndim != 2:
        return values.T.take(rows, axis=-1).T
    # One by one: NumPy copies all rows of arrays that are parts of larger ones.
    taken = np.empty((values.shape[1], len(rows)), values.dtype)
    for component, into in zip(values.T, taken, strict=True):
        into[:] = component.take(rows)
    return taken.T


def put(values: NDArray[Any], rows: Rows, some: NDArray[Any]) -> None:
    """Replace some of (N, C) or (N,) values, in place."""
    if values.ndim == 1:
        values[rows] = some
        return
    for component, of_some in zip(values.T, some.T, strict=True):
        component[rows] = of_some


def dot(some: Floats, others: Floats) -> Floats:
    """Return the (N,) products of (N, 3) vectors, or of those and one of (3,)."""
    found = some[:, 0] * others[..., 0]
    found += some[:, 1] * others[..., 1]
    found += some[:, 2] * others[..., 2]
    return found


def cross(some: Floats, others: Floats) -> Floats:
    """Return the (N, 3) cross products of (N, 3) vectors."""
    found = empty(*some.shape)
    (a, b, c), (x, y, z) = some.T, others.T
    found[:, 0], found[:, 1], found[:, 2] = b * z - c * y, c * x - a * z, a * y - b * x
    return found


def normalise(vectors: Floats) -> Floats:
    """Return (N, 3) vectors of length 1; zero vectors stay zero."""
    length = np.sqrt(np.maximum(dot(vectors, vectors), np.float32(1e-24)))
    return np.asarray(vectors * (1 / length)[:, None])


def rows_where(is_wanted: NDArray[np.bool_]) -> Rows:
    """Return the rows of (N,) that are wanted."""
    some = np.flatnonzero(is_wanted)
    return slice(None) if len(some) == len(is_wanted) else some
