"""What glaciers leave: troughs with the section of a parabola, and moraines around their ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oaisys_core.types import FloatArray


class Troughs(NamedTuple):
    """Parabolic troughs above the floors of valleys, both (rows, cols).

    Attributes:
        surface_m: Height of their walls.
        floor_m: Height of the floor below which each point lies.
    """

    surface_m: FloatArray
    floor_m: FloatArray


def troughs_around(
    floor_m: FloatArray, spacing_m: float, half_width_m: float, depth_m: float
) -> Troughs:
    """Return the lowest of the parabolas that stand on floors.

    Sections of glacial valleys are close to parabolas (Svensson, J. Glaciology 3(25), 1959).

    Args:
        floor_m: (rows, cols) heights of valley floors; infinite elsewhere.
        spacing_m: Distance between cells.
        half_width_m: Distance from the middle of a trough to its shoulder.
        depth_m: Height of the shoulder above the floor.
    """
    reach = int(np.ceil(1.5 * half_width_m / spacing_m))
    curvature = depth_m / half_width_m**2 * spacing_m**2
    surface_m, base_m = floor_m, floor_m
    for axis in (0, 1):
        surface_m, base_m = _lowest(surface_m, base_m, axis, reach, curvature)
    return Troughs(surface_m, base_m)


def _lowest(
    surface_m: FloatArray, base_m: FloatArray, axis: int, reach: int, curvature: float
) -> tuple[FloatArray, FloatArray]:
    """Return the lowest parabola along an axis, and the floor it stands on."""
    best_m, floor_m = surface_m.copy(), base_m.copy()
    size = surface_m.shape[axis]
    for step in range(1, min(reach, size - 1) + 1):
        rise_m = curvature * step**2
        for here, there in (
            (slice(0, size - step), slice(step, size)),
            (slice(step, size), slice(0, size - step)),
        ):
            to = (here, slice(None)) if axis == 0 else (slice(None), here)
            of = (there, slice(None)) if axis == 0 else (slice(None), there)
            risen_m = surface_m[of] + rise_m
            lower = risen_m < best_m[to]
            np.copyto(best_m[to], risen_m, where=lower)
            np.copyto(floor_m[to], base_m[of], where=lower)
    return best_m, floor_m


def moraine(
    elevation_m: FloatArray,
    floor_m: FloatArray,
    *,
    end_m: float,
    head_m: float,
    thickness_m: float,
    height_m: float,
) -> FloatArray:
    """Return (rows, cols) heights of the ridge that a glacier heaped up around its edge.

    The ice had the profile of plastic ice: its thickness grows with the root of what lies between a
    floor and the glacier's end (Nye 1951). Where its surface met the valley's sides there are
    lateral moraines, and an end moraine across the floor.

    Args:
        elevation_m: (rows, cols) heights of the valley.
        floor_m: (rows, cols) heights of the floor below, see `Troughs`; infinite far from troughs.
        end_m, head_m: Heights of the floor at the glacier's end and at its head.
        thickness_m: Thickness of the ice at the head.
        height_m: Height of the ridge.
    """
    share = (floor_m - end_m) / max(head_m - end_m, 1e-9)
    share = np.where(np.isfinite(share), share, -1.0)
    ice_m = np.where(np.isfinite(floor_m), floor_m, end_m)
    ice_m = ice_m + thickness_m * np.sqrt(np.clip(share, 0.0, 1.0))
    off = (elevation_m - ice_m) / (1.5 * height_m)
    ridge = np.maximum(1.0 - off * off, 0.0) ** 2
    fade = np.clip((share + 0.1) / 0.1, 0.0, 1.0) * np.clip((0.7 - share) / 0.25, 0.0, 1.0)
    return np.asarray(height_m * ridge * fade)
