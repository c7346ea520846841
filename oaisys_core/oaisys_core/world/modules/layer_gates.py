"""How well the conditions of layers hold at each texel of their masks."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.layer_conditions import ConditionConfig
from oaisys_core.procedural.terrain.masks.forces import GroundForces
from oaisys_core.procedural.terrain.masks.patches import gate
from oaisys_core.procedural.terrain.masks.relief import Relief, relief_of
from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.scene import Ground

Bounds = tuple[float, float]

FLOODED_M, BARELY = (0.1, 0.4), 1e-9
"""Depths of water in which layers of plants become less, and in which there are none; and how well
conditions of other layers hold there at least."""


def layer_gates(
    conditions: Sequence[ConditionConfig | None],
    ground: Ground,
    size_px: int,
    *,
    green: Sequence[bool] = (),
    water_m: float | None = None,
) -> NDArray[np.float32] | None:
    """Return (L, size_px, size_px) weights, 0 to 1, of the layers' conditions; None without any.

    Plants, which are ``green``, end where they would be deep below a level of water.
    """
    ends_in_water = water_m is not None and any(green) and not all(green)
    if len(conditions) == 1 or not (any(conditions) or ends_in_water):
        return None
    relief, forces = relief_of(ground, size_px), GroundForces(ground)
    gates = np.ones((len(conditions), size_px, size_px), np.float32)
    for index, when in enumerate(conditions):
        if when is not None:
            gates[index] = condition_gate(when, relief)
            for values, bounds, soft in _forced(when, forces):
                np.minimum(
                    gates[index], gate(_resize(values, size_px), bounds, soft), out=gates[index]
                )
    if water_m is not None and ends_in_water:
        _end_in_water(gates, np.array(green), water_m - relief.height_m)
    return gates


def _end_in_water(gates: NDArray[np.float32], is_green: NDArray[np.bool_], depth_m: Field) -> None:
    """Close the gates of plants where water is deep."""
    least_m, most_m = FLOODED_M
    flooded = np.clip((depth_m - least_m) / (most_m - least_m), 0, 1)
    gates[is_green] *= 1 - flooded
    # Where nothing else may lie either, whatever is no plant does.
    gates[~is_green] = np.maximum(gates[~is_green], np.float32(BARELY) * flooded)


def condition_gate(when: ConditionConfig, relief: Relief) -> NDArray[np.float32]:
    """Return how well conditions of slope and height hold at each texel of a mask, 0 to 1."""
    slope_deg = np.degrees(relief.slope_rad)
    result = gate(slope_deg, _open_ends(when.slope_deg, (0.0, 90.0)), when.soft_deg)
    if when.height_m is not None:
        result = np.minimum(result, gate(relief.height_m, when.height_m, when.soft_m))
    if when.height_share is not None:
        low, high = float(relief.height_m.min()), float(relief.height_m.max())
        # An open end stays so on level ground, where infinity times no height would be no number.
        least_m, most_m = (
            low + share * (high - low) if isfinite(share) else share
            for share in _open_ends(when.height_share, (0.0, 1.0))
        )
        result = np.minimum(result, gate(relief.height_m, (least_m, most_m), when.soft_m))
    return result


def gate_of_level(when: ConditionConfig) -> float:
    """Return how well a plain meets the conditions that do not ask for its height.

    Nothing stands out of a plain or shelters it, no rock falls on it, and water runs nowhere.
    """
    found = gate(0.0, _open_ends(when.slope_deg, (0.0, np.inf)), when.soft_deg)
    for bounds, value in ((when.flow_share, 0.5), (when.debris_share, 0), (when.crest_share, 0.5)):
        if bounds is not None:
            found = np.minimum(found, gate(value, _open_ends(bounds, (0.0, 1.0)), when.soft_share))
    if when.shelter_deg is not None:
        found = np.minimum(found, gate(0.0, when.shelter_deg, when.soft_deg))
    return float(found)


def _forced(when: ConditionConfig, forces: GroundForces) -> list[tuple[Field, Bounds, float]]:
    """Return values on the ground, their bounds and widths of fades, of what water and wind do."""
    found: list[tuple[Field, Bounds, float]] = []
    share = (0.0, 1.0)
    if when.flow_share is not None:
        found.append((forces.flow_share, _open_ends(when.flow_share, share), when.soft_share))
    if when.debris_share is not None:
        found.append((forces.debris_share, _open_ends(when.debris_share, share), when.soft_share))
    if when.crest_share is not None:
        crests = forces.crest_share(when.crest_size_m)
        found.append((crests, _open_ends(when.crest_share, share), when.soft_share))
    if when.shelter_deg is not None:
        shelter_deg = forces.shelter_deg(when.wind_from_deg)
        found.append((shelter_deg, _open_ends(when.shelter_deg, (-90.0, 90.0)), when.soft_deg))
    return found


def _open_ends(bounds: Bounds, ends: Bounds) -> Bounds:
    """Return bounds without those at an end of the scale: what lies there is fully inside."""
    least, most = bounds
    return least if least > ends[0] else -np.inf, most if most < ends[1] else np.inf


def _resize(values: Field, size_px: int) -> Field:
    import cv2

    return np.asarray(cv2.resize(values, (size_px, size_px), interpolation=cv2.INTER_LINEAR))
