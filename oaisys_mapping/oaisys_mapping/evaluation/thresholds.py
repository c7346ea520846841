"""Thresholds that a reconstruction must meet to count as closed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

ROUNDING = 1e-9
"""Relative difference up to which limits count as equal."""


@dataclass(frozen=True)
class Criterion:
    """A figure against its limit.

    Attributes:
        name: Name of the figure in `ReconstructionMetrics`.
        is_upper: Whether the limit is an upper limit, else it is a lower one.
    """

    name: str
    value: float
    limit: float
    is_upper: bool

    @property
    def holds(self) -> bool:
        """Whether the limit is met; NaN meets none."""
        return self.value <= self.limit if self.is_upper else self.value >= self.limit

    @property
    def bound(self) -> str:
        """The limit in words, such as ``at most 0.03``."""
        return f"at {'most' if self.is_upper else 'least'} {self.limit:g}"

    def is_looser_than(self, other: Criterion) -> bool:
        """Whether this limit accepts figures that another one rejects."""
        if self.is_upper != other.is_upper:
            return True
        beyond = self.limit - other.limit if self.is_upper else other.limit - self.limit
        return not beyond <= ROUNDING * abs(other.limit)

    def __str__(self) -> str:
        return f"{self.name} is {self.value:.4g}, expected {self.bound}"


@dataclass(frozen=True)
class Thresholds:
    """Limits of figures; None where there is no limit.

    Attributes:
        max_rmse_m, min_completion, min_f_score, max_holes: Limits of ``rmse_m``,
            ``completion_ratio``, ``f_score`` and ``hole_ratio``.
        max_median_m: Limit of ``accuracy_median_m``, in which errors at rocks' edges do not hide
            a bias.
        max_offset_m: Limit of ``offset_m``.
        max_overlap_holes: Limit of ``overlap_hole_count``.
        min_iou: Limit of ``least_iou``; applied only to maps with labels.
    """

    max_rmse_m: float | None = None
    min_completion: float | None = None
    min_f_score: float | None = None
    max_holes: float | None = None
    max_median_m: float | None = None
    max_offset_m: float | None = None
    max_overlap_holes: float | None = None
    min_iou: float | None = None

    @property
    def _limits(self) -> tuple[tuple[str, float | None, bool], ...]:
        """Each figure's name and limit, and whether it is an upper limit."""
        return (
            ("rmse_m", self.max_rmse_m, True),
            ("completion_ratio", self.min_completion, False),
            ("f_score", self.min_f_score, False),
            ("hole_ratio", self.max_holes, True),
            ("accuracy_median_m", self.max_median_m, True),
            ("offset_m", self.max_offset_m, True),
            ("overlap_hole_count", self.max_overlap_holes, True),
            ("least_iou", self.min_iou, False),
        )

    def criteria_of(self, metrics: Any) -> list[Criterion]:
        """Return the figures of a `ReconstructionMetrics` that have a limit, with these limits."""
        return [
            Criterion(name, float(getattr(metrics, name)), limit, is_upper)
            for name, limit, is_upper in self._limits
            if limit is not None and getattr(metrics, name) is not None
        ]

    def criteria_of_figures(self, figures: Mapping[str, Any]) -> list[Criterion]:
        """Return what `criteria_of` does, for figures by name; those not measured may be absent."""
        known = dict.fromkeys((name for name, *_ in self._limits))
        return self.criteria_of(SimpleNamespace(**known | dict(figures)))

    def misses_of(self, metrics: Any) -> list[str]:
        """Return one sentence for each threshold that is missed."""
        return [str(found) for found in self.criteria_of(metrics) if not found.holds]


def survey_thresholds(voxel_size_m: float) -> Thresholds:
    """Return the thresholds of a survey: hardly any holes, no bias, errors of a third of a voxel.

    Correct intrinsics and poses give medians below 2 mm and offsets below 0.5 mm at 10 cm voxels,
    so these limits are tight. In maps with labels, each class with 1 % of the surface has a limit.
    """
    return Thresholds(
        max_rmse_m=0.3 * voxel_size_m,
        min_completion=0.98,
        min_f_score=0.98,
        max_holes=0.01,
        max_median_m=0.05 * voxel_size_m,
        max_offset_m=0.05 * voxel_size_m,
        max_overlap_holes=0,
        min_iou=0.9,
    )


def exploration_thresholds(voxel_size_m: float) -> Thresholds:
    """Return the thresholds of an exploration, whose camera looks ahead.

    It sees distant ground at grazing angles, a few pixels per voxel. Some of that may be missing,
    but what was mapped must be accurate.
    """
    return Thresholds(max_rmse_m=voxel_size_m / 2, min_completion=0.9, min_f_score=0.9)
