"""What a reconstruction must reach to count as closed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

ROUNDING = 1e-9
"""Share of a limit by which an equal one may differ."""


@dataclass(frozen=True)
class Criterion:
    """A figure against its limit.

    Attributes:
        name: Of the figure among those of a `ReconstructionMetrics`.
        is_upper: Whether the figure may be at most the limit, not at least.
    """

    name: str
    value: float
    limit: float
    is_upper: bool

    @property
    def holds(self) -> bool:
        """Whether the limit is kept; a figure that is no number keeps none."""
        return self.value <= self.limit if self.is_upper else self.value >= self.limit

    @property
    def asked(self) -> str:
        """The limit in words."""
        return f"at {'most' if self.is_upper else 'least'} {self.limit:g}"

    def is_looser_than(self, other: Criterion) -> bool:
        """Whether this limit lets a figure pass that another one does not."""
        if self.is_upper != other.is_upper:
            return True
        beyond = self.limit - other.limit if self.is_upper else other.limit - self.limit
        return not beyond <= ROUNDING * abs(other.limit)

    def __str__(self) -> str:
        return f"{self.name} is {self.value:.4g}, expected {self.asked}"


@dataclass(frozen=True)
class Thresholds:
    """Limits of figures; None: not asked for.

    Attributes:
        max_rmse_m, min_completion, min_f_score, max_holes: Of ``rmse_m``, ``completion_ratio``,
            ``f_score`` and ``hole_ratio``.
        max_median_m: Of ``accuracy_median_m``, which rocks' edges do not hide a bias from.
        max_offset_m: Of ``offset_m``, the shift that would lay the map on the truth.
        max_overlap_holes: Of ``overlap_hole_count``.
        min_iou: Of ``least_iou``; asked only of maps that have labels.
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
    def _wanted(self) -> tuple[tuple[str, float | None, bool], ...]:
        """Each figure's name and limit, and whether that is an upper one."""
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

    def applied_to(self, metrics: Any) -> list[Criterion]:
        """Return what was asked for of a `ReconstructionMetrics`, and whether it is reached."""
        return [
            Criterion(name, float(getattr(metrics, name)), limit, is_upper)
            for name, limit, is_upper in self._wanted
            if limit is not None and getattr(metrics, name) is not None
        ]

    def asked_of(self, figures: Mapping[str, Any]) -> list[Criterion]:
        """Return the same as `applied_to`, of figures by name; those not measured may be absent."""
        known = dict.fromkeys((name for name, *_ in self._wanted))
        return self.applied_to(SimpleNamespace(**known | dict(figures)))

    def missed_by(self, metrics: Any) -> list[str]:
        """Return one sentence for each threshold that is missed."""
        return [str(found) for found in self.applied_to(metrics) if not found.holds]


def survey_thresholds(voxel_size_m: float) -> Thresholds:
    """Return what counts as closed: nearly nothing missing, no bias, errors of a third of a voxel.

    Median and offset are held ten times tighter than 2 cm at 10 cm voxels would need: with right
    intrinsics and poses they are below 2 mm and 0.5 mm. Of maps with labels each class with 1 % of
    the surface is asked for, too.
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
    """Return what counts as closed where a camera looks ahead.

    It sees ground far away at grazing angles, a few pixels to a voxel: what it saw of that may
    miss, but what is there must be right.
    """
    return Thresholds(max_rmse_m=voxel_size_m / 2, min_completion=0.9, min_f_score=0.9)
