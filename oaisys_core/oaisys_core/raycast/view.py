"""What the rays of a camera's pixels meet, and values by the instances that they meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import Scene
from oaisys_core.system.ending.interruption import stop_if_unwanted
from oaisys_core.types import FloatArray

NO_TARGET = -1
"""Target of a pixel that sees nothing."""

BAND_PIXELS = 80_000
"""Pixels that are worked on at a time, at most. Of more, intermediate arrays do not fit into a
core's cache; with fewer, threads more often wait for Python's lock."""

HALVED_PIXELS = 40_000
"""Pixels from which on an image has two bands at least, for two cores."""


@dataclass(frozen=True)
class View:
    """What each pixel of a camera sees at its centre; all arrays are (H, W) or (H, W, 3).

    Those of a camera's pixels have vectors component by component in memory, as NumPy works on them
    fastest.

    Attributes:
        depth_m: float64 planar z, ``+inf`` where nothing was hit.
        directions: float64 rays in ``map``, scaled so that their planar z is 1.
        points_m: float64 in ``map``; not finite where nothing was hit.
        targets: int64 index of the surface's ray target that was hit, `NO_TARGET` for none.
        elements: int64 index of that target's element, see `RayTarget`.
        instance_ids: uint32, 0 for ground and sky.
    """

    depth_m: FloatArray
    directions: FloatArray
    points_m: FloatArray
    targets: NDArray[np.int64]
    elements: NDArray[np.int64]
    instance_ids: NDArray[np.uint32]

    def rows(self, rows: slice | NDArray[np.intp]) -> View:
        """Return a view of some rows; that of a slice shares its memory with the whole."""
        return View(**{name: take_rows(array, rows) for name, array in self._arrays().items()})

    def pixels(self, pixels: NDArray[np.intp] | slice) -> View:
        """Return a view of one column of (N,) pixels, which count row by row."""
        return View(
            **{
                name: take_rows(array.reshape(-1, 1, *array.shape[2:]), pixels)
                for name, array in self._arrays().items()
            }
        )

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def is_hit(self) -> NDArray[np.bool_]:
        """(H, W) whether the pixel's ray hits anything."""
        return np.isfinite(self.depth_m)

    @cached_property
    def is_ground(self) -> NDArray[np.bool_]:
        """(H, W) whether the pixel's ray hits the ground."""
        return np.asarray(self.is_hit & (self.instance_ids == 0))


class InstanceTable:
    """Values by instance id, where ids may be sparse; 0 for ids that no object has."""

    def __init__(
        self, scene: Scene, of_placements: Sequence[Any], of_primitives: Sequence[Any], dtype: Any
    ) -> None:
        """Take one value for each placement and for each primitive of a scene."""
        counts = [len(placement.instance_ids) for placement in scene.placements]
        ids = [placement.instance_ids for placement in scene.placements]
        ids.append(np.array([p.instance_id for p in scene.primitives], np.uint32))
        values = np.asarray([*of_placements, *of_primitives], dtype)
        of_ids = np.repeat(values, [*counts, *(1 for _ in scene.primitives)], axis=0)
        all_ids = np.concatenate(ids).astype(np.uint32)
        order = np.argsort(all_ids, kind="stable")
        nothing = np.zeros((1, *of_ids.shape[1:]), of_ids.dtype)
        self._ids = np.concatenate((np.zeros(1, np.uint32), all_ids[order]))
        self._values = np.concatenate((nothing, of_ids[order]))

    def __call__(self, ids: NDArray[np.uint32]) -> NDArray[Any]:
        """Return the values of (...) ids, of shape (..., *value's shape)."""
        place = np.searchsorted(self._ids, ids, side="right") - 1
        place = np.where(self._ids[place] == ids, place, 0)
        return np.asarray(self._values[place])


def empty_vectors(*shape: int) -> FloatArray:
    """Return a (*shape, 3) array of anything, one component of all after the other."""
    return np.moveaxis(np.empty((3, *shape)), 0, -1)


def take_rows(array: NDArray[Any], rows: slice | NDArray[np.intp]) -> NDArray[Any]:
    """Return some rows of an array, in its order of memory.

    `numpy.take` is thrice as fast as an index, but copies arrays in any other order than C's.
    """
    if isinstance(rows, slice):
        return array[rows]
    if array.flags.c_contiguous or array.ndim < 2:
        return array.take(rows, axis=0)
    taken = [component.take(rows, axis=0) for component in np.moveaxis(array, -1, 0)]
    return np.moveaxis(np.array(taken), 0, -1)


def count_bands(height_px: int, width_px: int) -> int:
    """Return how many `bands` an image has at most."""
    pixels = height_px * width_px
    return max(-(-pixels // BAND_PIXELS), 2 if pixels >= HALVED_PIXELS else 1)


def bands(height_px: int, width_px: int) -> Iterator[slice]:
    """Yield slices of rows that cover an image; raise between them if the work was cancelled."""
    rows = max(-(-height_px // count_bands(height_px, width_px)), 1)
    for first in range(0, height_px, rows):
        stop_if_unwanted()
        yield slice(first, min(first + rows, height_px))
