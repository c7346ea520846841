"""The species by name.

Each generator returns a plant scaled to 1 m, with its foot at the origin; its leaves have their own
size where it is scaled to the size in metres that was given.
"""

from __future__ import annotations

from functools import partial

from oaisys_core.procedural.scatter.plants import herbs, shrubs
from oaisys_core.procedural.scatter.plants.fitting import PlantGenerator, fitted

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

SPECIES: dict[str, PlantGenerator] = {
    **{
        build.__name__: partial(fitted, build.__name__, build)
        for build in (herbs.meadow, herbs.flower_meadow, herbs.sedge, herbs.reed, herbs.bracken)
    },
    **{name: partial(plant.grow, name) for name, plant in WOODY.items()},
}
