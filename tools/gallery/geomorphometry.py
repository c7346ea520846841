"""Figures of geomorphology for grounds that processes made, beside those of real landscapes.

``python -m tools.gallery.geomorphometry`` prints them; ``make gallery`` does at its end.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from oaisys_core.procedural.terrain.landscapes.crater_field import COVERAGE
from oaisys_core.procedural.terrain.presets import SHAPED, make_ground
from oaisys_core.procedural.terrain.processes.flow import FlowNetwork, route
from oaisys_core.procedural.terrain.processes.impacts import draw_impacts
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

EXTENT_M, SIZE_PX, SEED = 120.0, 769, 1

SUPPORT_CELLS = 250
"""Drained cells from which on a cell counts as channel."""

FITTED = (250, 15_000)
"""Drained cells between which slope and area are fitted: above hillslopes, whose slope the angle of
repose limits, and below areas of which there are few."""

REACH_DOUBLINGS = 4
"""Slopes are measured over two to the power of this many cells."""

BINS = 10

SHARES = (25, 50, 75, 95)
"""Percentiles of slopes."""


class Geomorphometry(NamedTuple):
    """Figures of a ground.

    Attributes:
        concavity: Exponent by which the slope of channels falls with the drained area.
        hypsometric_integral: Mean height above the lowest point over the relief.
        slope_deg: Quartiles and the 95th percentile of slopes.
        drainage_density_per_m: Length of channels over area.
    """

    concavity: float
    hypsometric_integral: float
    slope_deg: list[float]
    drainage_density_per_m: float


def measure(ground: HeightField) -> Geomorphometry:
    """Return the figures of a ground."""
    z, spacing_m = ground.elevation_m.astype(np.float64), ground.spacing_m
    flow = route(z, spacing_m, None)
    cells = flow.accumulate(np.ones(z.size))
    heights_m = z.ravel()[flow.order]
    inner = np.arange(z.size) >= flow.bounds[1]
    slope = _reach_slopes(heights_m, flow)
    up = np.gradient(z, spacing_m)
    slope_deg = np.degrees(np.arctan(np.hypot(*up)))
    is_channel = (cells >= SUPPORT_CELLS) & inner
    return Geomorphometry(
        concavity(cells[inner], slope[inner]),
        float((z.mean() - z.min()) / max(np.ptp(z), 1e-9)),
        [round(float(value), 2) for value in np.percentile(slope_deg, SHARES)],
        float(flow.length_m[is_channel].sum() / (z.size * spacing_m**2)),
    )


def _reach_slopes(heights_m: FloatArray, flow: FlowNetwork) -> FloatArray:
    """Return the slopes of the ways of water over the next cells, because single steps are rough.

    Slopes of reaches that rise, out of depressions, count as 0.
    """
    reached = flow.receiver
    length_m = flow.length_m * (np.arange(len(heights_m)) >= flow.bounds[1])
    for _ in range(REACH_DOUBLINGS):
        length_m = length_m + length_m[reached]
        reached = reached[reached]
    fall_m = np.maximum(heights_m - heights_m[reached], 0.0)
    return np.asarray(fall_m / np.maximum(length_m, 1e-9))


def concavity(area: FloatArray, slope: FloatArray) -> float:
    """Return the exponent of slope against area, over the median slopes of classes of areas.

    Medians, because hard beds and walls make steps in the channels.
    """
    edges = np.geomspace(*FITTED, BINS + 1)
    place = np.digitize(area, edges) - 1
    points = []
    for index in range(BINS):
        chosen = slope[place == index]
        if len(chosen) >= 20 and np.median(chosen) > 0:
            middle = np.sqrt(edges[index] * edges[index + 1])
            points.append((np.log(middle), np.log(np.median(chosen))))
    if len(points) < 3:
        return float("nan")
    x, y = np.array(points).T
    return float(-np.polyfit(x, y, 1)[0])


def crater_exponents(seed: int = SEED) -> tuple[float, float]:
    """Return the exponents of the number of craters above a diameter, below and above the bend."""
    largest_m = 100.0
    bend_m = 0.1 * largest_m
    impacts = draw_impacts(
        1000.0,
        np.random.default_rng(seed),
        smallest_m=1.0,
        largest_m=largest_m,
        equilibrium_m=bend_m,
        coverage=COVERAGE,
    )
    return (
        _exponent(impacts.diameter, 1.0, 0.3 * bend_m),
        _exponent(impacts.diameter, bend_m, 4 * bend_m),
    )


def _exponent(diameter: FloatArray, low: float, high: float) -> float:
    """Return the exponent of a power law from counts in bins of diameters."""
    edges = np.geomspace(low, high, 9)
    counts = np.histogram(diameter, edges)[0] / np.diff(edges)
    middle = np.sqrt(edges[1:] * edges[:-1])
    used = counts > 0
    return float(np.polyfit(np.log(middle[used]), np.log(counts[used]), 1)[0]) + 1.0


def write_geomorphometry(out: Path) -> str:
    """Write the figures of all presets made by processes as JSON, and return them as a table."""
    rows, figures = [], {}
    for preset in sorted(SHAPED):
        ground = make_ground(preset, EXTENT_M, SIZE_PX, np.random.default_rng(SEED))
        found = measure(ground)
        figures[preset] = found._asdict()
        slopes = " ".join(f"{value:5.1f}" for value in found.slope_deg)
        rows.append(
            f"{preset:16s} {found.concavity:9.2f} {found.hypsometric_integral:10.2f}"
            f"  {slopes} {found.drainage_density_per_m:13.2f}"
        )
    small, large = crater_exponents()
    figures["crater_exponents"] = {"equilibrium": small, "production": large}
    (out / "geomorphometry.json").write_text(json.dumps(figures, indent=2))
    head = "preset           concavity hypsometry  slope 25 50 75 95 %, deg  channels, 1/m\n"
    return head + "\n".join(rows) + f"\ncraters above D: D^{small:.2f}, large ones D^{large:.2f}"


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(write_geomorphometry(Path()))
