"""What a reconstruction must reach to count as closed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


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

    def applied_to(self, metrics: Any) -> list[Criterion]:
        """Return what was asked for of a `ReconstructionMetrics`, and whether it is reached."""
        wanted = (
            ("rmse_m", self.max_rmse_m, True),
            ("completion_ratio", self.min_completion, False),
            ("f_score", self.min_f_score, False),
            ("hole_ratio", self.max_holes, True),
            ("accuracy_median_m", self.max_median_m, True),
            ("offset_m", self.max_offset_m, True),
            ("overlap_hole_count", self.max_overlap_holes, True),
            ("least_iou", self.min_iou, False),
        )
        return [
            Criterion(name, float(getattr(metrics, name)), limit, is_upper)
            for name, limit, is_upper in wanted
            if limit is not None and getattr(metrics, name) is not None
        ]

    def missed_by(self, metrics: Any) -> list[str]:
        """Return one sentence for each threshold that is missed."""
        return [str(found) for found in self.applied_to(metrics) if not found.holds]
