"""Lookup of values by instance ids, which may be sparse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene import Scene


class IdTable:
    """Values by instance id; 0 for ids that it does not contain."""

    def __init__(self, ids: NDArray[np.uint32], values: NDArray[Any]) -> None:
        order = np.argsort(ids, kind="stable")
        nothing = np.zeros((1, *values.shape[1:]), values.dtype)
        self._ids = np.concatenate((np.zeros(1, np.uint32), ids[order]))
        self._values = np.concatenate((nothing, values[order]))

    def __call__(self, ids: NDArray[np.uint32]) -> NDArray[Any]:
        """Return the values of (...) ids, of shape (..., *value's shape)."""
        place = np.searchsorted(self._ids, ids, side="right") - 1
        place = np.where(self._ids[place] == ids, place, 0)
        return np.asarray(self._values[place])


def table_of(
    scene: Scene, of_placements: Sequence[Any], of_primitives: Sequence[Any], dtype: Any
) -> IdTable:
    """Return a table from one value for each placement and each primitive of a scene."""
    counts = [len(placement.instance_ids) for placement in scene.placements]
    ids = [placement.instance_ids for placement in scene.placements]
    ids.append(np.array([p.instance_id for p in scene.primitives], np.uint32))
    values = np.asarray([*of_placements, *of_primitives], dtype)
    repeated = np.repeat(values, [*counts, *(1 for _ in scene.primitives)], axis=0)
    return IdTable(np.concatenate(ids).astype(np.uint32), repeated)
