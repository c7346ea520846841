"""The unit of the heights in a file."""

from __future__ import annotations

import logging

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.reading import StoredModel
from oaisys_core.procedural.terrain.elevation.references import UNIT_M, Reference

LOG = logging.getLogger(__name__)

SAME = 1e-5
"""Difference of two units that does not matter, as of the two feet: 2 mm in 1 km."""


def height_unit_m(
    model: StoredModel, reference: Reference | None, stated: str | None, field: str
) -> float:
    """Return metres per unit of a file's heights, negative for depths.

    Args:
        model: The file's own unit.
        reference: Its reference system, whose vertical part may have a unit.
        stated: Name of the unit in the configuration, which overrides both.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: The file contradicts itself, or leaves open whether its heights are in
            feet.
    """
    vertical_m = None if reference is None else reference.height_unit_m
    sign = -1.0 if vertical_m is not None and vertical_m < 0 else 1.0
    if stated is not None:
        return sign * UNIT_M[stated]
    own_m = UNIT_M[model.unit.lower()] if model.unit else None
    if vertical_m is None:
        if own_m is None:
            _check_unit_is_clear(reference, field)
        return own_m or 1.0
    assert reference is not None
    if own_m is not None and abs(own_m / abs(vertical_m) - 1) > SAME:
        expected = (
            f"m, ft or us-ft, because the file says both {model.unit}"
            f" and {reference.height_name} in its reference system"
        )
        raise InvalidInputError(f"{field}.height_unit", None, expected)
    return vertical_m


def _check_unit_is_clear(reference: Reference | None, field: str) -> None:
    if reference is None or reference.horizontal.is_geographic or reference.unit_m == 1.0:
        return
    expected = (
        f"the unit of heights (m, ft or us-ft), because the file says none, and its coordinates"
        f" are in {reference.unit_name}"
    )
    raise InvalidInputError(f"{field}.height_unit", None, expected)
