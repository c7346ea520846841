"""The figures of a reconstruction and their formulas, from distances to and from the truth.

Accuracy, completion and F-score are those of Knapitsch et al., "Tanks and Temples", ACM TOG 36(4),
2017: distances from points spread evenly over the reconstruction to the truth, and back. Accuracy
counts all of the reconstruction, floating artefacts included. Completeness is given twice: for the
truth that the poses could see, which is the mapper's responsibility, and, with ``_all`` in the
name, for all of the truth, which is also the planner's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.evaluation.semantics import ClassAgreement
from oaisys_mapping.evaluation.tsdf_metrics import TsdfMetrics


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
class ReconstructionMetrics:
    """Figures of one reconstruction: lengths in metres, areas in square metres, ratios 0 to 1.

    Attributes:
        voxel_size_m: Size of the voxel that the figures refer to.
        accuracy_mean_m, accuracy_median_m, rmse_m, accuracy_max_m: Distance from the
            reconstruction to the truth.
        completion_mean_m: Distance from the visible truth to the reconstruction.
        completion_ratio, completion_ratio_2: Share of visible truth within 1 and 2 voxels of it.
        precision, precision_2: Share of the reconstruction within 1 and 2 voxels of the truth.
        f_score, f_score_2: Harmonic mean of precision and completion at one and two voxels.
        chamfer_m: Mean of ``accuracy_mean_m`` and ``completion_mean_m``.
        offset_m, offset_xyz_m: Shift of the whole reconstruction from the truth; see
            `offset_to_truth`.
        hole_ratio, hole_count, hole_area_m2, largest_hole_m2: `holes.Holes` in the visible truth
            inside the rim of the surveyed area.
        gap_ratio: Share of that area where nothing was reconstructed within two voxels along the
            normal, including slits too narrow to be holes.
        overlap_area_m2: Part of that area that at least two views see.
        overlap_hole_ratio, overlap_hole_count, overlap_hole_area_m2: Holes in the overlap.
        overlap_farthest_m: Greatest distance from the truth in the overlap to the reconstruction.
        surveyed_area_m2: Area of the visible truth as seen from above.
        visible_share: Share of the truth's area that is visible.
        completion_mean_all_m, completion_ratio_all, completion_ratio_2_all, f_score_all,
            f_score_2_all, chamfer_all_m, gap_ratio_all: The same for all of the truth.
        visible_samples, truth_samples, reconstruction_samples: Number of points measured.
        past_rim_share: Share of the reconstruction beyond the outer rim of an open truth, where
            nothing is known; the other figures exclude it.
        f_scores: F-scores at further tolerances.
        classes: Labels of the map compared with those of the visible truth.
        tsdf: Figures of the signed distances, where the volume was given.
    """

    voxel_size_m: float
    accuracy_mean_m: float
    accuracy_median_m: float
    rmse_m: float
    accuracy_max_m: float
    completion_mean_m: float
    completion_ratio: float
    completion_ratio_2: float
    precision: float
    precision_2: float
    f_score: float
    f_score_2: float
    chamfer_m: float
    offset_m: float
    offset_xyz_m: tuple[float, float, float]
    hole_ratio: float
    hole_count: int
    hole_area_m2: float
    largest_hole_m2: float
    gap_ratio: float
    overlap_area_m2: float
    overlap_hole_ratio: float
    overlap_hole_count: int
    overlap_hole_area_m2: float
    overlap_farthest_m: float
    surveyed_area_m2: float
    visible_share: float
    completion_mean_all_m: float
    completion_ratio_all: float
    completion_ratio_2_all: float
    f_score_all: float
    f_score_2_all: float
    chamfer_all_m: float
    gap_ratio_all: float
    visible_samples: int
    truth_samples: int
    reconstruction_samples: int
    past_rim_share: float = 0.0
    f_scores: tuple[FScore, ...] = ()
    classes: ClassAgreement | None = None
    tsdf: TsdfMetrics | None = None

    @property
    def least_iou(self) -> float | None:
        """Lowest IoU among the classes of the surface; see `ClassAgreement.least`."""
        return self.classes.least if self.classes is not None else None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures by name as JSON values; those not measured are absent."""
        figures = asdict(self)
        figures["offset_xyz_m"] = list(self.offset_xyz_m)
        figures["f_scores"] = [asdict(score) for score in self.f_scores]
        del figures["classes"], figures["tsdf"]
        if self.classes is not None:
            figures["iou"] = dict(self.classes.iou)
            figures["iou_share"] = dict(self.classes.share)
            figures["least_iou"] = self.least_iou
        return figures | (asdict(self.tsdf) if self.tsdf is not None else {})


@dataclass(frozen=True)
class Completeness:
    """Distances from parts of the truth to the reconstruction.

    Attributes:
        parts: (N,) distances in metres, and the area in square metres that each point represents.
    """

    parts: tuple[tuple[FloatArray, float], ...]

    def mean(self, value_of: Callable[[FloatArray], NDArray[Any]]) -> float:
        """Return the area-weighted mean of ``value_of`` of the distances."""
        areas_m2 = np.array([len(distance_m) * area_m2 for distance_m, area_m2 in self.parts])
        means = [value_of(distance_m).mean() for distance_m, _ in self.parts if len(distance_m)]
        return float(np.average(means, weights=areas_m2[areas_m2 > 0]))

    def within(self, tau_m: float) -> float:
        """Return the share of the area that is no further away than ``tau_m``."""
        return self.mean(lambda distance_m: distance_m <= tau_m)

    @property
    def mean_m(self) -> float:
        """Area-weighted mean distance."""
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
    """Return those figures of `ReconstructionMetrics` that follow from distances alone."""
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
