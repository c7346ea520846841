"""Incision by running water and what it lays down, by the stream power law.

The scheme is implicit, and stable at any step (Braun and Willett, "A very efficient O(n), implicit
and parallel method to solve the stream power equation governing fluvial incision and landscape
evolution", Geomorphology 180-181, 2013). Sediment is laid down in proportion to its flux over the
drained area (Davy and Lague 2009; Yuan et al., "A new efficient method to solve the stream power
law model taking into account sediment deposition", JGR Earth Surface 124, 2019).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.procedural.terrain.processes.flow import FlowNetwork
from oaisys_core.types import FloatArray

DEPOSITION_ROUNDS = 2
"""Rounds by which the sediment's flux and the heights agree on each other."""


class WaterWork(NamedTuple):
    """What running water did in one step.

    Attributes:
        elevation_m: (rows, cols) heights after it.
        area_m2: (rows, cols) drained areas.
        deposited_m: (rows, cols) thickness laid down.
    """

    elevation_m: FloatArray
    area_m2: FloatArray
    deposited_m: FloatArray


def run_water(
    elevation_m: FloatArray,
    flow: FlowNetwork,
    spacing_m: float,
    erodibility: float | FloatArray,
    uplift_m: float | FloatArray = 0.0,
    deposition: float = 0.0,
) -> WaterWork:
    """Return the ground after one step of uplift, incision and deposition.

    Incision is ``erodibility * sqrt(area) * slope``, with the drained area in square metres: the
    exponents are m = 0.5 and n = 1, so that the concavity m / n of channels is 0.5, in the middle
    of what rivers have (0.4 to 0.6; Kirby and Whipple, J. Struct. Geol. 44, 2012), and a square
    root has the same bits on every machine. Where rock rises at the rate U and nothing changes any
    more, the slope is ``(1 + deposition) * U / (K * sqrt(area))``.

    Args:
        elevation_m: (rows, cols) heights.
        flow: Where water runs on them; outlets keep their height.
        spacing_m: Distance between cells.
        erodibility: K times the step's duration; a number, or (rows, cols).
        uplift_m: Rise in this step, not of outlets.
        deposition: Dimensionless coefficient G: 0 carries all sediment out, 1 is usual for rivers.
    """
    shape = elevation_m.shape
    cell_m2 = spacing_m**2
    area_m2 = flow.accumulate(np.full(elevation_m.size, cell_m2))
    rate = np.sqrt(area_m2) / flow.length_m * _in_order(erodibility, flow, shape)
    outlets = flow.bounds[1]
    before_m = elevation_m.ravel()[flow.order]
    before_m[outlets:] += _in_order(uplift_m, flow, shape)[outlets:]
    laid_m = np.zeros_like(before_m)
    after_m = _incise(before_m, rate, flow)
    for _ in range(DEPOSITION_ROUNDS if deposition else 0):
        lost_m3 = (before_m - after_m) * cell_m2
        flux_m3 = np.maximum(flow.accumulate(lost_m3) - lost_m3, 0.0)
        laid_m = deposition * flux_m3 / area_m2
        laid_m[:outlets] = 0.0
        after_m = _incise(before_m + laid_m, rate, flow)
    return WaterWork(
        flow.on_grid(after_m, shape), flow.on_grid(area_m2, shape), flow.on_grid(laid_m, shape)
    )


def _in_order(values: float | FloatArray, flow: FlowNetwork, shape: tuple[int, ...]) -> FloatArray:
    field = np.asarray(values, np.float64)
    if not field.ndim:
        return np.broadcast_to(field, len(flow.order))
    return np.broadcast_to(field, shape).ravel()[flow.order]


def _incise(before_m: FloatArray, rate: FloatArray, flow: FlowNetwork) -> FloatArray:
    """Return the (N,) heights of an implicit step, from the outlets upwards.

    No cell sinks below the one it drains into; where that is higher, in a depression, it stays.
    """
    after_m = before_m.copy()
    weight = 1.0 / (1.0 + rate)
    share = rate * weight
    for place, into in flow.levels():
        base_m = after_m[into]
        own_m = before_m[place]
        lowered_m = own_m * weight[place] + base_m * share[place]
        after_m[place] = np.minimum(own_m, lowered_m)
    return after_m


def fill_depressions(elevation_m: FloatArray, flow: FlowNetwork) -> FloatArray:
    """Return (rows, cols) heights at which water stands: those of the ground, or of a spill."""
    level_m = elevation_m.ravel()[flow.order]
    for place, into in flow.levels():
        level_m[place] = np.maximum(level_m[place], level_m[into])
    return flow.on_grid(level_m, elevation_m.shape)
