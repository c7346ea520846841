"""Errors of a map's signed distances at the true surface, where they should be 0.

As in voxblox (Oleynikova et al., IROS 2017), the error at a point of the true surface is the
absolute value of the interpolated distance, clipped. Points without a distance are counted
separately.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from oaisys_core.types import FloatArray
from oaisys_mapping.evaluation.true_surface import TrueSurface

CLIP_VOXELS = 3
"""Errors are clipped at this many voxels."""


class SignedDistanceMap(Protocol):
    """A map with signed distances to the surface where it was observed."""

    def distance_at(self, points_m: FloatArray) -> FloatArray:
        """Return (N,) signed distances in metres at (N, 3) points, NaN where unknown."""
        ...

    @property
    def volume_observed_m3(self) -> float:
        """Volume of observed space."""
        ...


@dataclass(frozen=True)
class TsdfMetrics:
    """Figures of signed distances.

    Attributes:
        tsdf_rmse_m: Root mean square of the distances at visible truth, each clipped at three
            voxels; None if all are unknown.
        unknown_share, unknown_share_all: Share of the visible truth, and of all of it, at which
            the distance is unknown.
        observed_volume_m3: Volume of observed space.
    """

    tsdf_rmse_m: float | None
    unknown_share: float
    unknown_share_all: float
    observed_volume_m3: float


def tsdf_metrics(
    surface: TrueSurface, volume: SignedDistanceMap, voxel_size_m: float
) -> TsdfMetrics:
    """Return the figures of a map's distances at a true surface."""
    at_truth_m = volume.distance_at(surface.visible.points_m)
    known_m = at_truth_m[np.isfinite(at_truth_m)]
    error_m = np.minimum(np.abs(known_m), CLIP_VOXELS * voxel_size_m)
    parts = [(at_truth_m, surface.visible.area_m2)]
    parts += [(volume.distance_at(p.points_m), p.area_m2) for p in surface.unseen]
    unknown_m2 = sum(float((~np.isfinite(at_m)).sum()) * area_m2 for at_m, area_m2 in parts)
    return TsdfMetrics(
        tsdf_rmse_m=float(np.sqrt(np.square(error_m).mean())) if len(known_m) else None,
        unknown_share=1 - len(known_m) / len(at_truth_m),
        unknown_share_all=unknown_m2 / sum(len(at_m) * area_m2 for at_m, area_m2 in parts),
        observed_volume_m3=volume.volume_observed_m3,
    )
