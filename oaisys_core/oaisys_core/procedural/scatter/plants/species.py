"""The species by name.

Each generator returns a plant scaled to 1 m, with its foot at the origin; its leaves have their own
size where it is scaled to the size in metres that was given.
"""

from __future__ import annotations

from functools import partial

from pydantic import TypeAdapter

from oaisys_core.procedural.scatter.plants import herbs
from oaisys_core.procedural.scatter.plants.fitting import PlantGenerator, fit_to_size
from oaisys_core.procedural.scatter.plants.organ_sizes import TABLE
from oaisys_core.procedural.scatter.plants.shrubs import WoodyPlant

WOODY = TypeAdapter(dict[str, WoodyPlant]).validate_python(TABLE["woody"])
"""Shrubs and trees, as ``plants.yaml`` describes them."""

SPECIES: dict[str, PlantGenerator] = {
    **{
        build.__name__: partial(fit_to_size, build.__name__, build)
        for build in (herbs.meadow, herbs.flower_meadow, herbs.sedge, herbs.reed, herbs.bracken)
    },
    **{name: partial(plant.grow, name) for name, plant in WOODY.items()},
}
