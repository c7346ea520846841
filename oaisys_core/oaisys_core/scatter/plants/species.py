"""The species by name; each generator returns a plant of 1 m, with its foot at the origin."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from oaisys_core.scatter.plants import herbs, shrubs
from oaisys_core.scene import MeshPrototype

WOODY = {
    "heather": shrubs.HEATHER,
    "juniper": shrubs.JUNIPER,
    "willow": shrubs.WILLOW,
    "hawthorn": shrubs.HAWTHORN,
    "birch": shrubs.BIRCH,
    "oak": shrubs.OAK,
    "pine": shrubs.PINE,
    "dwarf_pine": shrubs.DWARF_PINE,
    "spruce": shrubs.SPRUCE,
}

SPECIES: dict[str, Callable[[np.random.Generator], MeshPrototype]] = {
    "meadow": herbs.meadow,
    "flower_meadow": herbs.flower_meadow,
    "sedge": herbs.sedge,
    "reed": herbs.reed,
    "bracken": herbs.bracken,
    **{name: partial(plant.grow, name) for name, plant in WOODY.items()},
}
