"""Impact craters: how many of which size and age there are, and how time wears them down."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray

DEPTH, RIM = 0.196, 0.036
"""From rim to floor, and of the rim above the ground, in diameters of a fresh simple crater (Pike,
"Size-dependence in the shape of fresh impact craters on the Moon", 1977)."""

REACH = 3.5
"""Distance, in radii, up to which a crater changes the ground."""

PRODUCTION, EQUILIBRIUM = -3.0, -2.0
"""Exponents of the number of craters larger than a diameter: as they form, for diameters below a
kilometre (Neukum, Ivanov and Hartmann 2001), and where small ones vanish as fast as they form."""

SATURATION = 1.54
"""Craters larger than D times D squared, of a plane that has room for no more (Gault 1970)."""

WORN = 0.05
"""Diffusivity times time over the squared diameter at which a crater is as good as gone: a fresh
one is then an eighth as deep."""

STEP, STEPS_KEPT = 0.01, 24
"""Of the profiles by age: distance between their points in diameters, and their number."""


class Impacts(NamedTuple):
    """N craters, the oldest first.

    Attributes:
        center: (N, 2) x and y.
        diameter: (N,).
        wear: (N,) diffusivity times time since, over the squared diameter: 0 is fresh.
    """

    center: FloatArray
    diameter: FloatArray
    wear: FloatArray


POINTS = 3.5
"""Cells across the smallest crater that a grid shows."""


def draw_impacts(
    extent_m: float,
    rng: np.random.Generator,
    *,
    smallest_m: float,
    largest_m: float,
    equilibrium_m: float,
    coverage: float,
) -> Impacts:
    """Return craters on a square from (0, 0), by a production function and all of its past.

    Above ``equilibrium_m`` all craters that ever formed are there, by the production function;
    below it only those that time has not yet worn away.

    Args:
        extent_m: Edge length.
        rng: Draws them.
        smallest_m, largest_m: Bounds of diameters.
        equilibrium_m: Diameter of craters that are as old as the ground when they vanish.
        coverage: Share of saturation below that diameter: 0.01 to 0.1 on the Moon.
    """
    per_m2 = coverage * SATURATION
    bend_m = min(max(equilibrium_m, smallest_m), largest_m)
    small = per_m2 * (smallest_m**EQUILIBRIUM - bend_m**EQUILIBRIUM)
    large = per_m2 * bend_m * (bend_m**PRODUCTION - largest_m**PRODUCTION)
    area_m2 = (extent_m + largest_m) ** 2
    counts = rng.poisson((small * area_m2, large * area_m2))
    diameter = np.concatenate((
        _power_law(rng.random(counts[0]), smallest_m, bend_m, EQUILIBRIUM),
        _power_law(rng.random(counts[1]), bend_m, largest_m, PRODUCTION),
    ))  # fmt: skip
    wear = WORN * rng.random(len(diameter)) * np.minimum(bend_m / diameter, 1.0) ** 2
    center = rng.uniform(-largest_m / 2, extent_m + largest_m / 2, (len(diameter), 2))
    order = np.argsort(-wear * diameter**2, kind="stable")
    return Impacts(center[order], diameter[order], wear[order])


def _power_law(share: FloatArray, low: float, high: float, exponent: float) -> FloatArray:
    """Return diameters whose number above D falls as a power of D, by cumulative shares."""
    if high <= low:
        return np.full(share.shape, low)
    least, most = low**exponent, high**exponent
    # Rounded, because powers differ in their last bits.
    return np.asarray(np.round((least + share * (most - least)) ** (1 / exponent), 9))


def fresh_profile(radius: FloatArray) -> FloatArray:
    """Return heights of a fresh crater in diameters, at distances in diameters from its centre.

    Ejecta thin out with the cube of the distance (McGetchin, Settle and Head 1973).
    """
    r = 2 * np.asarray(radius)
    bowl = (RIM - DEPTH) + DEPTH * r * r
    r = np.maximum(r, 1e-6)
    ejecta = RIM / (r * r * r)
    return np.asarray(np.where(r < 1, bowl, ejecta))


@cache
def worn_profiles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (STEPS_KEPT,) wears and (STEPS_KEPT, R) heights in diameters, at steps of `STEP`.

    Diffusion, as micrometeorites do it (Fassett and Thomson, "Crater degradation on the lunar
    maria", JGR Planets 119, 2014), in rings, of which each gets what its neighbour loses.
    """
    middle = (np.arange(int(4 * REACH / 2 / STEP)) + 0.5) * STEP
    border = middle[:-1] + STEP / 2
    height = fresh_profile(middle)
    kept, wears, wear = [height], [0.0], 0.0
    targets = WORN * (np.arange(1, STEPS_KEPT) / (STEPS_KEPT - 1)) ** 2
    for target in targets:
        steps = int(np.ceil((target - wear) / (0.2 * STEP**2)))
        for _ in range(steps):
            flux = border * np.diff(height) / STEP * ((target - wear) / steps)
            height = height.copy()
            height[:-1] += flux / (middle[:-1] * STEP)
            height[1:] -= flux / (middle[1:] * STEP)
        wear = float(target)
        kept.append(height)
        wears.append(wear)
    return np.array(wears), np.array(kept)


def profile_of(wear: float) -> FloatArray:
    """Return the heights of a crater in diameters, at steps of `STEP` from half of it on."""
    wears, profiles = worn_profiles()
    place = float(np.interp(wear, wears, np.arange(len(wears))))
    low = min(int(place), len(wears) - 2)
    share = place - low
    return np.asarray(profiles[low] * (1 - share) + profiles[low + 1] * share)


def add_impacts(
    elevation_m: FloatArray, spacing_m: float, impacts: Impacts, rng: np.random.Generator
) -> FloatArray:
    """Return the ground after impacts, of which each digs away what was there before.

    Args:
        elevation_m: (rows, cols) heights, the first at (0, 0).
        spacing_m: Distance between cells.
        impacts: The craters; those of less than `POINTS` cells are left out.
        rng: Draws how far their rims are from circles.
    """
    z = elevation_m.astype(np.float64)
    waves = rng.uniform(-1.0, 1.0, (len(impacts.diameter), 2, 2)) * (0.05, 0.035)
    for index in np.flatnonzero(impacts.diameter >= POINTS * spacing_m):
        _add(z, spacing_m, impacts, index, waves[index])
    return z


def _add(z: FloatArray, spacing_m: float, impacts: Impacts, index: int, waves: FloatArray) -> None:
    center, diameter_m = impacts.center[index], float(impacts.diameter[index])
    reach_m = REACH * diameter_m / 2
    size = z.shape[::-1]
    low = np.clip(np.ceil((center - reach_m) / spacing_m), 0, size).astype(int)
    high = np.clip(np.floor((center + reach_m) / spacing_m) + 1, 0, size).astype(int)
    if (high <= low).any():
        return
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    x = (np.arange(low[0], high[0]) * spacing_m - center[0])[None, :]
    y = (np.arange(low[1], high[1]) * spacing_m - center[1])[:, None]
    squared = np.maximum(x * x + y * y, 1e-12)
    # Waves around the rim, twice and three times, as polynomials of the direction.
    root = np.sqrt(squared)
    c, s = x / root, y / root
    twice, sine = c * c - s * s, 2 * c * s
    lobes = waves[0, 0] * twice + waves[1, 0] * sine
    lobes = lobes + waves[0, 1] * (c * twice - s * sine) + waves[1, 1] * (s * twice + c * sine)
    radius = root * (1 + lobes) / diameter_m
    old_m = z[window]
    inside = np.clip((0.58 - radius) / 0.16, 0.0, 1.0)
    weight = float(inside.sum())
    level_m = float((old_m * inside).sum()) / weight if weight > 0 else 0.0
    freshness = 1.0 - float(impacts.wear[index]) / WORN
    old_m += (0.3 + 0.6 * max(freshness, 0.0)) * inside * (level_m - old_m)
    profile = profile_of(float(impacts.wear[index]))
    place = radius / STEP - 0.5
    cell = np.clip(place.astype(np.intp), 0, len(profile) - 2)
    share = np.clip(place - cell, 0.0, 1.0)
    heights = profile[cell] + share * (profile[cell + 1] - profile[cell])
    fade = np.clip((REACH / 2 - radius) / (REACH / 2 - 0.8), 0.0, 1.0)
    old_m += diameter_m * heights * fade
