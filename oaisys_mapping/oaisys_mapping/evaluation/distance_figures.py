"""Accuracy, completion and F-score, from distances between a reconstruction and the truth.

As in Knapitsch et al., "Tanks and Temples", ACM TOG 36(4), 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class FScore:
    """Precision, completion and their harmonic mean at one tolerance."""

    tau_m: float
    precision: float
    completion: float
    f_score: float
    completion_all: float
    f_score_all: float


@dataclass(frozen=True)
class Completeness:
    """Distances from parts of the truth to the reconstruction, and each point's area."""

    parts: tuple[tuple[FloatArray, float], ...]

    def mean(self, value_of: Any) -> float:
        """Return the mean over the area of what ``value_of`` makes of distances."""
        areas_m2 = np.array([len(distance_m) * area_m2 for distance_m, area_m2 in self.parts])
        means = [value_of(distance_m).mean() for distance_m, _ in self.parts if len(distance_m)]
        return float(np.average(means, weights=areas_m2[areas_m2 > 0]))

    def within(self, tau_m: float) -> float:
        """Return the share that is no further away than ``tau_m``."""
        return self.mean(lambda distance_m: distance_m <= tau_m)

    @property
    def mean_m(self) -> float:
        """The mean distance."""
        return self.mean(lambda distance_m: distance_m)


def f_score_at(
    tau_m: float, to_truth_m: FloatArray, visible: Completeness, everything: Completeness
) -> FScore:
    """Return precision, completion and F-score at a tolerance."""
    precision = float((to_truth_m <= tau_m).mean())
    completion, completion_all = visible.within(tau_m), everything.within(tau_m)
    return FScore(
        tau_m,
        precision,
        completion,
        _harmonic_mean(precision, completion),
        completion_all,
        _harmonic_mean(precision, completion_all),
    )


def distance_figures(
    to_truth_m: FloatArray, visible: Completeness, everything: Completeness, voxel_size_m: float
) -> dict[str, Any]:
    """Return the figures of a `ReconstructionMetrics` that distances alone give."""
    one, two = (f_score_at(n * voxel_size_m, to_truth_m, visible, everything) for n in (1, 2))
    mean_m = float(to_truth_m.mean())
    return {
        "accuracy_mean_m": mean_m,
        "accuracy_median_m": float(np.median(to_truth_m)),
        "rmse_m": float(np.sqrt(np.square(to_truth_m).mean())),
        "accuracy_max_m": float(to_truth_m.max()),
        "completion_mean_m": visible.mean_m,
        "completion_ratio": one.completion,
        "completion_ratio_2": two.completion,
        "precision": one.precision,
        "precision_2": two.precision,
        "f_score": one.f_score,
        "f_score_2": two.f_score,
        "chamfer_m": (mean_m + visible.mean_m) / 2,
        "completion_mean_all_m": everything.mean_m,
        "completion_ratio_all": one.completion_all,
        "completion_ratio_2_all": two.completion_all,
        "f_score_all": one.f_score_all,
        "f_score_2_all": two.f_score_all,
        "chamfer_all_m": (mean_m + everything.mean_m) / 2,
    }


def _harmonic_mean(a: float, b: float) -> float:
    return 0.0 if a + b == 0 else 2 * a * b / (a + b)
