"""What water, falling rock and wind do at each place of a ground, found from its heights alone."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.terrain.processes.flow import FlowNetwork, route
from oaisys_core.scene import Ground
from oaisys_core.types import FloatArray

CELLS = 384
"""Cells along each edge of the ground."""

ROUNDS = 4
"""Drawings of the flow's directions over which drained areas and debris are averaged."""

SHEDDING = float(np.tan(np.radians(40.0)))
"""Tangent of the slope from which on rock falls."""

REPOSE = float(np.tan(np.radians(34.0)))
"""Tangent of the angle of repose of debris."""

RUN_OUT_M = 12.0
"""Distance on level ground within which all but 1/e of what falls has come to rest."""

SMOOTH_PX = 1.0
"""Standard deviation of the smoothing of heights before water runs over them."""

WIND_REACH_M = 100.0
"""Farthest ground upwind that shelters a place (Winstral, Elder and Davis, 2002)."""

WIND_STEP = 1.12
"""Growth of the distances upwind at which heights are compared."""


class GroundForces:
    """What water, debris and wind do on a ground; each is worked out when it is first asked for.

    All values are (CELLS, CELLS) float32, row 0 at the smallest y. A ground without a surface
    somewhere counts as high there, so that neither water nor wind comes from there.
    """

    def __init__(self, ground: Ground) -> None:
        """Take the heights of a ground."""
        x0, y0, x1, y1 = ground.extent_m
        centres = (np.arange(CELLS) + 0.5) / CELLS
        x, y = np.meshgrid(x0 + (x1 - x0) * centres, y0 + (y1 - y0) * centres)
        height_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
        self._is_ground = np.isfinite(height_m)
        self._height_m = np.where(self._is_ground, height_m, np.nanmax(height_m))
        self._edges_m = x1 - x0, y1 - y0
        self._spacing_m = max(self._edges_m) / CELLS

    @cached_property
    def flow_share(self) -> Field:
        """Share of the ground by which less water runs than here, from the drained area."""
        shape = self._height_m.shape
        ones = np.ones(self._height_m.size)
        area = sum(
            (flow.on_grid(flow.accumulate(ones), shape) for flow in self._flows), np.zeros(shape)
        )
        # A channel is wider than the line that water takes on a grid.
        wide = scipy.ndimage.maximum_filter(np.log(area), 3)
        return self._ranks(scipy.ndimage.gaussian_filter(wide, 1.0, truncate=2.0))

    @cached_property
    def debris_share(self) -> Field:
        """Share of the ground on which less fallen rock rests than here; 0 where none does."""
        resting = sum((self._resting(flow) for flow in self._flows), np.zeros_like(self._height_m))
        return self._ranks(scipy.ndimage.gaussian_filter(resting, 1.0, truncate=2.0))

    def crest_share(self, size_m: float) -> Field:
        """Return the share of the ground that stands out of its surroundings less than here.

        Args:
            size_m: Size of the forms.
        """
        sigma_px = max(size_m / self._spacing_m / 2, 1.0)
        around_m = scipy.ndimage.gaussian_filter(self._height_m, sigma_px, mode="nearest")
        return self._ranks(self._height_m - around_m)

    def shelter_deg(self, wind_from_deg: float) -> Field:
        """Return the angle to the highest ground upwind, in degrees; negative where all is lower.

        It is the parameter Sx of Winstral, Elder and Davis, "Spatial snow modeling of
        wind-redistributed snow using terrain-based parameters", J. Hydrometeorology 3(5), 2002.

        Args:
            wind_from_deg: Azimuth that the wind comes from, clockwise from +y.
        """
        azimuth = np.radians(wind_from_deg)
        step_x, step_y = np.sin(azimuth), np.cos(azimuth)
        px_m = [edge_m / CELLS for edge_m in self._edges_m]
        steepest = np.full(self._height_m.shape, -np.inf)
        for distance_m in self._distances_m():
            shift_px = -step_y * distance_m / px_m[1], -step_x * distance_m / px_m[0]
            upwind_m = scipy.ndimage.shift(
                self._height_m, shift_px, order=1, mode="nearest", prefilter=False
            )
            np.maximum(steepest, (upwind_m - self._height_m) / distance_m, out=steepest)
        return np.asarray(np.degrees(np.arctan(steepest)), np.float32)

    @cached_property
    def _flows(self) -> list[FlowNetwork]:
        rng = np.random.default_rng(0)
        return [route(self._smooth_m, self._spacing_m, rng) for _ in range(ROUNDS)]

    @cached_property
    def _smooth_m(self) -> FloatArray:
        smooth_m = scipy.ndimage.gaussian_filter(self._height_m, SMOOTH_PX, mode="nearest")
        return np.asarray(smooth_m, np.float64)

    def _resting(self, flow: FlowNetwork) -> FloatArray:
        """Return how much of the rock that falls from steep cells comes to rest in each cell.

        It runs down the ways of water, past slopes steeper than its angle of repose; of gentler
        ones, the more level they are the more of it stays on each metre.
        """
        height_m = self._smooth_m.ravel()[flow.order]
        slope = (height_m - height_m[flow.receiver]) / flow.length_m
        moving = np.clip(slope / SHEDDING - 1, 0, 1)
        share = 1 - np.exp(-flow.length_m / RUN_OUT_M * np.clip(1 - slope / REPOSE, 0, 1))
        for place, into in reversed(list(flow.levels())):
            low = int(into[0])
            flows = np.bincount(into - low, weights=moving[place] * (1 - share[place]))
            moving[low : low + len(flows)] += flows
        return flow.on_grid(moving * share, self._height_m.shape)

    def _distances_m(self) -> list[float]:
        reach_m = min(WIND_REACH_M, max(self._edges_m) / 2)
        distances_m = [self._spacing_m]
        while distances_m[-1] < reach_m:
            further_m = max(distances_m[-1] * WIND_STEP, distances_m[-1] + self._spacing_m)
            distances_m.append(min(further_m, reach_m))
        return distances_m

    def _ranks(self, values: FloatArray) -> Field:
        return ranks(values, self._is_ground).astype(np.float32)


def ranks(values: FloatArray, is_ground: NDArray[np.bool_]) -> FloatArray:
    """Return the share of the ground with smaller values; 0 where there is no ground."""
    ordered = np.sort(values[is_ground])
    share = np.searchsorted(ordered, values) / len(ordered)
    return np.where(is_ground, share, 0.0)
