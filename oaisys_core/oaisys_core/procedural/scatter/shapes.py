"""Built-in and installed shapes by name."""

from __future__ import annotations

import numpy as np

from oaisys_core import extensions
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.procedural.scatter.plants.species import SPECIES
from oaisys_core.procedural.scatter.rocks import ROCK_KINDS, make_rock
from oaisys_core.procedural.scatter.vegetation import LOW_PLANTS
from oaisys_core.procedural.scatter.vehicles import VEHICLES
from oaisys_core.scene import MeshPrototype

PLANTS = {**LOW_PLANTS, **SPECIES}
"""Generators of plants by name."""

SHAPES = ROCK_KINDS | PLANTS.keys() | VEHICLES.keys()

MATS = frozenset({"meadow", "flower_meadow", "moss_cushion"})
"""Plants that are wider than high."""

ROCK_DETAIL = ((1.3, 4), (0.3, 3), (0.1, 2), (0.0, 1))
"""Subdivisions of rocks by their largest size in metres."""


def make_shape(
    name: str,
    rng: np.random.Generator,
    largest_m: float = 1.0,
    detail: int | None = None,
    plant_m: float = 1.0,
) -> MeshPrototype:
    """Return a shape; rocks and plants are 1 m along their longest axis.

    Args:
        name: One of `SHAPES`, or of an installed scatterer.
        rng: Draws its form.
        largest_m: Size of the largest instance; larger rocks have more triangles.
        detail: Subdivisions of a rock; None to derive them from ``largest_m``.
        plant_m: Size to which a plant will be scaled, and at which its leaves have their own size.

    Raises:
        InvalidInputError: There is no such shape.
    """
    if name in ROCK_KINDS:
        if detail is None:
            detail = next(n for least_m, n in ROCK_DETAIL if largest_m > least_m)
        return make_rock(name, rng, detail)
    if name in VEHICLES:
        return VEHICLES[name]()
    if name in PLANTS:
        return PLANTS[name](rng, plant_m)
    check_shape(name, "shape")
    made = extensions.load(extensions.SCATTERERS, name)(rng)
    if not isinstance(made, MeshPrototype):
        raise InvalidInputError("shape", made, f"a MeshPrototype of the scatterer {name!r}")
    return made


def check_shape(name: str, field: str) -> None:
    """Raise if a shape is neither built in nor installed.

    Raises:
        InvalidInputError: Its path is ``field``.
    """
    if name not in SHAPES and not extensions.is_installed(extensions.SCATTERERS, name, SHAPES):
        known = SHAPES | extensions.names(extensions.SCATTERERS)
        raise InvalidInputError(field, name, one_of(known, name))
