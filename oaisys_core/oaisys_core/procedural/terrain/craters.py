"""Fields of impact craters: their sizes, and the shape of a crater.

Shapes of fresh craters after Pike, "Size-dependence in the shape of fresh impact craters on the
Moon", in "Impact and Explosion Cratering", 1977: depth 0.196 D, rim height 0.036 D; ejecta thin
out with the cube of the distance (McGetchin, Settle and Head, EPSL 20, 1973).
"""

from __future__ import annotations

import numpy as np

from oaisys_core.types import FloatArray

DEPTH_SHARE = 0.196
"""Depth of a fresh crater, from rim crest to floor, relative to its diameter."""

RIM_SHARE = 0.036
"""Height of the rim above the plain, relative to the diameter."""

REACH = 2.6
"""Extent of the ejecta in crater radii."""


def crater_field(
    size_px: int,
    extent_m: float,
    rng: np.random.Generator,
    *,
    largest_m: float,
    smallest_m: float,
    coverage: float = 0.05,
    exponent: float = 2.0,
    has_largest: bool = False,
) -> FloatArray:
    """Return (size_px, size_px) elevations in metres of a plain with craters of all ages.

    Args:
        size_px: Grid points along an edge.
        extent_m: Edge length.
        rng: Draws positions, sizes and ages.
        largest_m, smallest_m: Range of diameters.
        coverage: Share of the ground that the craters of one octave of sizes cover.
        exponent: The number of craters above a diameter D goes as D**-exponent; 2 is near
            equilibrium, 3 is typical of small craters on a young surface.
        has_largest: Whether one crater, fresh and complete, has the largest diameter; by chance,
            there may be none nearly as large.
    """
    diameter_m = crater_diameters(extent_m, rng, largest_m, smallest_m, coverage, exponent)
    count = len(diameter_m)
    margin_m = largest_m / 2
    center_m = rng.uniform(-margin_m, extent_m + margin_m, (count, 2))
    age = rng.uniform(size=count)
    if has_largest:
        diameter_m = np.append(diameter_m, largest_m)
        inside_m = rng.uniform(largest_m / 2, extent_m - largest_m / 2, (1, 2))
        center_m, age = np.concatenate((center_m, inside_m)), np.append(age, 0.0)
        count += 1
    # Old craters first, so that young ones cut into them.
    order = np.argsort(-age)
    spacing_m = extent_m / (size_px - 1)
    elevation_m = np.zeros((size_px, size_px))
    lobes = rng.uniform(0, 2 * np.pi, (count, 3))
    for i in order:
        _add_crater(
            elevation_m, spacing_m, center_m[i], float(diameter_m[i]), float(age[i]), lobes[i]
        )
    return elevation_m


def crater_diameters(
    extent_m: float,
    rng: np.random.Generator,
    largest_m: float,
    smallest_m: float,
    coverage: float,
    exponent: float,
) -> FloatArray:
    """Return (N,) power-law diameters between two bounds, as many as the coverage requires."""
    # Expected area of one crater of the truncated Pareto law, over one octave at the large end.
    octaves = max(np.log2(largest_m / smallest_m), 1e-6)
    sizes = np.geomspace(smallest_m, largest_m, 256)
    weights = sizes**-exponent
    weights /= weights.sum()
    mean_area_m2 = float((weights * np.pi / 4 * sizes**2).sum())
    count = round(coverage * octaves * extent_m**2 / mean_area_m2)
    u = rng.uniform(size=count)
    tail = (smallest_m / largest_m) ** exponent
    return np.asarray(smallest_m * (1 - u * (1 - tail)) ** (-1 / exponent))


def crater_profile(radius: FloatArray, freshness: float | FloatArray = 1.0) -> FloatArray:
    """Return elevations in crater diameters, at distances from the centre in crater radii.

    A fresh crater has a parabolic bowl, a sharp rim and an ejecta blanket; with age the bowl fills
    and the rim wears down.
    """
    fresh = np.asarray(freshness)
    depth = (DEPTH_SHARE - RIM_SHARE) * (0.25 + 0.75 * fresh)
    rim = RIM_SHARE * (0.15 + 0.85 * fresh)
    bowl = -depth + (depth + rim) * radius**2
    ejecta = rim * np.maximum(radius, 1e-3) ** -3.0
    # Fades to nothing at the reach, where the window ends.
    ejecta = ejecta * np.clip((REACH - radius) / (REACH - 1), 0, 1)
    # A soft minimum rounds the crest, the more the older it is.
    edge = 0.004 + 0.02 * (1 - fresh)
    return np.asarray(-edge * np.logaddexp(-bowl / edge, -ejecta / edge))


def _add_crater(
    elevation_m: FloatArray,
    spacing_m: float,
    center_m: FloatArray,
    diameter_m: float,
    age: float,
    lobes: FloatArray,
) -> None:
    """Add one crater to a field: the inside of the rim is levelled, ejecta are added outside."""
    size = len(elevation_m)
    reach_m = REACH * diameter_m / 2
    low = np.clip(np.floor((center_m - reach_m) / spacing_m), 0, size).astype(int)
    high = np.clip(np.ceil((center_m + reach_m) / spacing_m) + 1, 0, size).astype(int)
    if (high <= low).any():
        return
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    x = np.arange(low[0], high[0]) * spacing_m - center_m[0]
    y = np.arange(low[1], high[1]) * spacing_m - center_m[1]
    angle = np.arctan2(y[:, None], x[None, :])
    radius = np.hypot(x[None, :], y[:, None]) / (diameter_m / 2)
    for wave, phase in enumerate(lobes, start=2):
        radius = radius * (1 + 0.05 / wave * np.cos(wave * angle + phase))
    old_m = elevation_m[window]
    inside = np.clip((1.15 - radius) / 0.3, 0, 1)
    weight = inside.sum()
    level_m = float((old_m * inside).sum() / weight) if weight > 0 else 0.0
    # An impact excavates the old surface; farther out its ejecta cover it.
    buried = inside * (0.35 + 0.5 * (1 - age))
    elevation_m[window] = old_m + buried * (level_m - old_m)
    elevation_m[window] += diameter_m * crater_profile(radius, 1 - age)
