"""Debris that falls from steep rock, runs down gullies and builds cones at their feet."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.processes.flow import FlowNetwork, route
from oaisys_core.procedural.terrain.processes.slopes import slide
from oaisys_core.types import FloatArray

SETTLING = 3
"""Passes of slides after each round, so that cones spread."""


def run_out(
    elevation_m: FloatArray, flow: FlowNetwork, amount_m: FloatArray, repose: float
) -> FloatArray:
    """Return (rows, cols) thickness at which loose debris comes to rest.

    It runs down the ways of water and stays where a cell would not become steeper than the angle of
    repose towards the next one; the rest runs on, and leaves at the outlets.

    Args:
        elevation_m: (rows, cols) heights.
        flow: Where debris runs.
        amount_m: (rows, cols) thickness that comes loose.
        repose: Tangent of the angle of repose.
    """
    shape = elevation_m.shape
    height_m = elevation_m.ravel()[flow.order]
    moving_m = amount_m.ravel()[flow.order]
    rest_m = np.zeros_like(moving_m)
    for place, into in reversed(list(flow.levels())):
        room_m = height_m[into] + repose * flow.length_m[place] - height_m[place]
        rest_m[place] = np.clip(room_m, 0.0, moving_m[place])
        on_m = moving_m[place] - rest_m[place]
        low = int(into[0])
        flows = np.bincount(into - low, weights=on_m)
        moving_m[low : low + len(flows)] += flows
    return flow.on_grid(rest_m, shape)


def drop_debris(
    elevation_m: FloatArray,
    spacing_m: float,
    rng: np.random.Generator,
    *,
    rock: float | FloatArray,
    repose: float,
    amount_m: float,
    rounds: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the ground after rock has fallen, and (rows, cols) thickness of the debris on it.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        rng: Draws where debris runs.
        rock: Tangents of slopes from which on rock sheds debris, a number or (rows, cols).
        repose: Tangent of the angle of repose of debris.
        amount_m: By how much rock twice as steep is lowered in all.
        rounds: Number of rounds.
    """
    z = elevation_m.astype(np.float64)
    debris_m = np.zeros_like(z)
    for _ in range(rounds):
        flow = route(z, spacing_m, rng)
        slope = _slope_down(z, flow)
        loose_m = np.clip(slope / rock - 1.0, 0.0, 1.0) * (amount_m / rounds)
        # Debris on slopes too steep for it comes loose, too.
        fallen_m = loose_m + np.where(slope > 1.05 * repose, debris_m, 0.0)
        debris_m -= fallen_m - loose_m
        z -= fallen_m
        rest_m = run_out(z, flow, fallen_m, repose)
        bare_m = z - debris_m
        z = z + rest_m
        covered = debris_m + rest_m > 0
        z = slide(z, spacing_m, np.where(covered, repose, 50.0), SETTLING)
        debris_m = np.maximum(z - bare_m, 0.0)
    return z, debris_m


def _slope_down(z: FloatArray, flow: FlowNetwork) -> FloatArray:
    """Return (rows, cols) slopes towards the next cell: the foot of a wall is level."""
    heights_m = z.ravel()[flow.order]
    slope = (heights_m - heights_m[flow.receiver]) / flow.length_m
    return flow.on_grid(np.maximum(slope, 0.0), z.shape)
