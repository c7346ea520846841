"""Points on instances of meshes, and which meshes are looked up together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.draft.appearance import Floats, take
from oaisys_core.scene import MeshPrototype


class MeshHits(NamedTuple):
    """N points on instances of meshes.

    Attributes:
        place: (N,) place of each instance in `Instances`.
        prototype: (N,) indices.
        offset_m: (N, 3) from the instance's origin, in the axes of ``map``.
        local_m: (N, 3) the same in the object's axes.
        R: (N, 3, 3) rotations from the object's axes to those of ``map``.
        normal: (N, 3) unit normals in ``map``, facing the eye.
        color, through: See `MeshPoints`.
        random: (N,) from 0 to 1, of each instance.
        footprint_m: (N,) sizes of a pixel there.
    """

    place: NDArray[np.intp]
    prototype: NDArray[np.intp]
    offset_m: Floats
    local_m: Floats
    R: Floats
    normal: Floats
    color: Floats
    through: Floats
    random: Floats
    footprint_m: Floats

    def take(self, rows: NDArray[np.intp]) -> MeshHits:
        """Return some of them."""
        taken: list[Any] = [take(each, rows) for each in self]
        return MeshHits(*taken)


def alike(
    prototypes: Sequence[MeshPrototype],
) -> tuple[NDArray[np.intp], list[MeshPrototype]]:
    """Return the group of each prototype, and one of each group.

    Rocks of the same textures are looked up together.
    """
    kinds: dict[object, int] = {}
    first: list[MeshPrototype] = []
    groups = np.zeros(len(prototypes), np.intp)
    for number, each in enumerate(prototypes):
        is_rock = each.maps is not None and each.water is None
        key = (id(each.maps), id(each.ground), bool(each.dust_m)) if is_rock else number
        if key not in kinds:
            kinds[key] = len(first)
            first.append(each)
        groups[number] = kinds[key]
    return groups, first
