"""Lava: lobes that run down, pile up and spread, with pressure ridges; and cones of cinder.

Flows are the sum of elliptic lobes, each of which begins on one before it and runs down the slope
of what has piled up (de' Michieli Vitturi and Tarquini, "MrLavaLoba: a new probabilistic model for
the simulation of lava flows as a settling process", J. Volcanol. Geotherm. Res. 349, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oaisys_core.procedural.terrain.processes.exact import DIGITS, draw_direction
from oaisys_core.types import FloatArray

INERTIA = 0.55
"""By how much a lobe keeps the direction of the one before."""

FRONT = 0.3
"""Share of a lobe's radius over which its edge falls: fronts are steep."""


@dataclass(frozen=True)
class LavaFlow:
    """How lava comes out.

    Attributes:
        vent: (x, y) in metres.
        lobes: Number of lobes.
        radius_m: Mean radius of a lobe.
        thickness_m: Thickness of a lobe.
    """

    vent: tuple[float, float]
    lobes: int
    radius_m: float
    thickness_m: float


@dataclass(frozen=True)
class Emplaced:
    """A ground with lava on it, all (rows, cols).

    Attributes:
        elevation_m: Heights.
        lava_m: Thickness of the lava.
        reached: Mean number of lobes between the vent and what lies there; 0 where there is none.
    """

    elevation_m: FloatArray
    lava_m: FloatArray
    reached: FloatArray


def emplace(
    elevation_m: FloatArray, spacing_m: float, flow: LavaFlow, rng: np.random.Generator
) -> Emplaced:
    """Return the ground after a flow.

    Args:
        elevation_m: (rows, cols) heights, the first at (0, 0).
        spacing_m: Distance between cells.
        flow: The flow.
        rng: Draws its lobes.
    """
    z = elevation_m.astype(np.float64)
    weight, reached = np.zeros_like(z), np.zeros_like(z)
    places, ways, depths = [flow.vent], [draw_direction(rng)], [0]
    size_m = (len(z) - 1) * spacing_m
    for _ in range(flow.lobes):
        parent = int(len(places) * rng.random() ** 0.6)
        place, way = _next(z, spacing_m, places[parent], ways[parent], flow.radius_m, rng)
        if not (0 < place[0] < size_m and 0 < place[1] < size_m):
            continue
        radius_m = flow.radius_m * float(rng.uniform(0.6, 1.4))
        window, lobe = _lobe(z.shape, spacing_m, place, way, radius_m)
        z[window] += flow.thickness_m * lobe
        weight[window] += lobe
        reached[window] += lobe * (depths[parent] + 1)
        places.append(place)
        ways.append(way)
        depths.append(depths[parent] + 1)
    reached = reached / np.maximum(weight, 1e-9)
    return Emplaced(z, flow.thickness_m * weight, reached)


def _next(
    z: FloatArray,
    spacing_m: float,
    place: tuple[float, float],
    way: tuple[float, float],
    radius_m: float,
    rng: np.random.Generator,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return where the next lobe lies and its direction: downhill, with inertia and chance."""
    reach = max(int(radius_m / spacing_m), 1)
    row = int(np.clip(round(place[1] / spacing_m), reach, len(z) - 1 - reach))
    col = int(np.clip(round(place[0] / spacing_m), reach, len(z) - 1 - reach))
    down = (
        float(z[row, col - reach] - z[row, col + reach]) / (2 * reach * spacing_m),
        float(z[row - reach, col] - z[row + reach, col]) / (2 * reach * spacing_m),
    )
    drawn = draw_direction(rng)
    x = INERTIA * way[0] * 0.12 + down[0] + 0.07 * drawn[0]
    y = INERTIA * way[1] * 0.12 + down[1] + 0.07 * drawn[1]
    length = max((x * x + y * y) ** 0.5, 1e-9)
    x, y = round(x / length, DIGITS), round(y / length, DIGITS)
    step_m = radius_m * float(rng.uniform(0.7, 1.3))
    return (place[0] + x * step_m, place[1] + y * step_m), (x, y)


def _lobe(
    shape: tuple[int, ...],
    spacing_m: float,
    place: tuple[float, float],
    way: tuple[float, float],
    radius_m: float,
) -> tuple[tuple[slice, slice], FloatArray]:
    """Return the window of a lobe, and its thickness there, 0 to 1."""
    reach = 1.6 * radius_m
    rows = slice(max(int((place[1] - reach) / spacing_m), 0),
                 min(int((place[1] + reach) / spacing_m) + 2, shape[0]))  # fmt: skip
    cols = slice(max(int((place[0] - reach) / spacing_m), 0),
                 min(int((place[0] + reach) / spacing_m) + 2, shape[1]))  # fmt: skip
    x = (np.arange(cols.start, cols.stop) * spacing_m - place[0])[None, :]
    y = (np.arange(rows.start, rows.stop) * spacing_m - place[1])[:, None]
    along, across = x * way[0] + y * way[1], y * way[0] - x * way[1]
    radius = np.sqrt((along / 1.35) ** 2 + across**2) / radius_m
    edge = np.clip((1 - radius) / FRONT, 0.0, 1.0)
    return (rows, cols), np.asarray(edge * (2 - edge))


def cinder_cone(
    x_m: FloatArray, y_m: FloatArray, *, height_m: float, repose: float, crater: float
) -> FloatArray:
    """Return heights of a cone of cinder around (0, 0), whose crater is as wide as its share.

    Fresh cones stand at the angle of repose, with craters 0.4 as wide as their bases (Porter, GSA
    Bull. 83, 1972; Wood, J. Volcanol. Geotherm. Res. 7, 1980).
    """
    base_m = height_m / repose / (1 - crater)
    radius_m = np.sqrt(x_m**2 + y_m**2)
    flank = repose * (base_m - radius_m)
    bowl = height_m - 0.8 * repose * (crater * base_m - radius_m)
    soft = 0.03 * height_m
    low = np.minimum(flank, bowl)
    # A rounded rim and foot, as a soft maximum by a root.
    return np.asarray(0.5 * (low + np.sqrt(low * low + soft * soft)))
