"""The sun, and Earth, as seen from the Moon and Mars: JPL's ephemeris DE421, read by Skyfield."""

from __future__ import annotations

from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment.body_axes import body_from_icrf
from oaisys_core.types import FloatArray

Target = Literal["sun", "earth"]
Observer = Literal["moon", "mars"]

J2000_DAY = 2451545.0
"""Julian day of J2000."""

YEARS = (1900, 2052)
"""First and last year that DE421 covers as a whole."""

PACKAGES = "the packages skyfield and skyfield-data: pip install 'oaisys_core[ephemeris]'"


def vector_km(body: Observer, target: Target, when: datetime) -> FloatArray:
    """Return the (3,) apparent position of a target from a body's centre, in the body's own axes.

    It is where light comes from: with its travelling time and aberration.

    Args:
        body: Where one looks from.
        target: What one looks at.
        when: Date and time with its offset from UTC.

    Raises:
        InvalidInputError: The packages that have the ephemeris are missing, or it does not cover
            the time.
    """
    if not YEARS[0] <= when.year <= YEARS[1]:
        expected = f"a year from {YEARS[0]} to {YEARS[1]}, which the ephemeris DE421 covers"
        raise InvalidInputError("environment.sun_from_time.date_time", when.isoformat(), expected)
    bodies, timescale = _de421()
    time = timescale.from_datetime(when)
    in_icrf_km = bodies[body].at(time).observe(bodies[target]).apparent().position.km
    return np.asarray(body_from_icrf(body, time.tdb - J2000_DAY) @ in_icrf_km)


@cache
def _de421() -> tuple[Any, Any]:
    """Return Skyfield's bodies and its scale of times; nothing is fetched."""
    try:
        from skyfield.api import load, load_file
        from skyfield_data import __file__ as data_module
    except ImportError as error:
        raise InvalidInputError("environment.sun_from_time", "a time", PACKAGES) from error
    # The package's own function warns of tables of Earth's rotation, which are not used here.
    file = Path(data_module).parent / "data" / "de421.bsp"
    return load_file(str(file)), load.timescale(builtin=True)
