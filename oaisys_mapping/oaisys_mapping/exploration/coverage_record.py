"""Records of explorations, and the comparison of planners over several worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special


@dataclass(frozen=True)
class CoverageRecord:
    """The exploration of one world by one planner.

    Attributes:
        planner: Name of the planner.
        seed: Seed of the world.
        coverage: Share of the reachable surface seen after each view.
        path_m: Length flown up to each view.
        plan_s: Median time to choose the next view.
        refused: Number of poses that the simulator refused.
        least_clearance_m: Least height of any pose above the true surface; None if unknown.
        ended: Why it ended.
        failed: Whether it ended because the planner failed, or before its first view: the world
            could not be built, or the view was refused.
    """

    planner: str
    seed: int
    coverage: Sequence[float]
    path_m: Sequence[float]
    plan_s: float
    refused: int = 0
    least_clearance_m: float | None = None
    ended: str = ""
    failed: bool = False

    @property
    def final_coverage(self) -> float:
        """Coverage at the end; 0 without a view."""
        return self.coverage[-1] if self.coverage else 0.0

    @property
    def length_m(self) -> float:
        """Length flown until the end; 0 without a view."""
        return self.path_m[-1] if self.path_m else 0.0

    def views_to(self, share: float) -> int | None:
        """Return the number of views after which coverage reached a share; None if it never did."""
        reached = np.flatnonzero(np.asarray(self.coverage) >= share)
        return int(reached[0]) + 1 if len(reached) else None


@dataclass(frozen=True)
class PlannerResult:
    """What a planner needed to reach a given coverage, over all worlds.

    Attributes:
        planner: Name of the planner.
        worlds: Number of worlds explored.
        reached: Number of worlds in which it reached the coverage.
        failed: Number of worlds in which it failed, see `CoverageRecord`. They count with the
            coverage and path that they had until then.
        views: Median number of views needed; None if it reached the coverage in less than half of
            the worlds.
        views_low, views_high: Confidence interval of that median, see `median_interval`; None:
            too few worlds, or an end that no world reached.
        fewest_views, most_views: Range over the worlds in which it reached the coverage.
        more_than_views: Lower bound if there is no median: the median number of views after
            which it stopped.
        path_m: Median length flown up to the coverage.
        final_coverage: Median coverage at the end; 0 without a view.
        plan_s: Median time to choose a view.
        refused: Number of poses that the simulator refused, in all worlds.
        least_clearance_m: Least height of any pose above the true surface; None if unknown.
    """

    planner: str
    worlds: int
    reached: int
    failed: int
    views: float | None
    views_low: int | None
    views_high: int | None
    fewest_views: int | None
    most_views: int | None
    more_than_views: float | None
    path_m: float | None
    final_coverage: float
    plan_s: float
    refused: int
    least_clearance_m: float | None


def planner_results(records: Sequence[CoverageRecord], share: float) -> list[PlannerResult]:
    """Return each planner's result, in the order of their first records."""
    names = dict.fromkeys(record.planner for record in records)
    return [_result([r for r in records if r.planner == name], share) for name in names]


def comparison_lines(results: Sequence[PlannerResult], share: float) -> list[str]:
    """Return a table of planners for a terminal: its header, and a line for each."""
    header = (
        "planner",
        "worlds",
        f"views to {share:.0%}",
        "95 % interval",
        "seen",
        "path, m",
        "failed",
    )
    rows = [header, *map(_cells, results)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(header))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _cells(result: PlannerResult) -> tuple[str, ...]:
    views = f"more than {result.more_than_views:g}" if result.views is None else f"{result.views:g}"
    low, high = result.views_low, result.views_high
    interval = "-" if low is None else f"{low} to {'more' if high is None else high}"
    path = "-" if result.path_m is None else f"{result.path_m:.0f}"
    seen = f"{result.final_coverage:.1%}"
    failed = str(result.failed) if result.failed else "-"
    return (
        result.planner,
        f"{result.reached} of {result.worlds}",
        views,
        interval,
        seen,
        path,
        failed,
    )


def _result(records: Sequence[CoverageRecord], share: float) -> PlannerResult:
    views = [record.views_to(share) for record in records]
    successes = [count for count in views if count is not None]
    paths_m = [
        np.inf if count is None else record.path_m[count - 1]
        for record, count in zip(records, views, strict=True)
    ]
    median_views = _median([np.inf if count is None else count for count in views])
    low, high = median_interval([np.inf if count is None else count for count in views])
    stopped_after = float(np.median([len(record.coverage) for record in records]))
    clearances_m = [m for m in (each.least_clearance_m for each in records) if m is not None]
    return PlannerResult(
        planner=records[0].planner,
        worlds=len(records),
        reached=len(successes),
        failed=sum(record.failed for record in records),
        views=median_views,
        views_low=low,
        views_high=high,
        fewest_views=min(successes, default=None),
        most_views=max(successes, default=None),
        more_than_views=stopped_after if median_views is None else None,
        path_m=_median(paths_m),
        final_coverage=float(np.median([record.final_coverage for record in records])),
        plan_s=float(np.median([record.plan_s for record in records])),
        refused=sum(record.refused for record in records),
        least_clearance_m=min(clearances_m, default=None),
    )


def median_interval(
    values: Sequence[float], confidence: float = 0.95
) -> tuple[int | None, int | None]:
    """Return a confidence interval of the median of what values were drawn from.

    Its ends are values: the k-th lowest and k-th highest, for the largest k at which the binomial
    distribution leaves at most half of the rest below and above. That assumes nothing of how they
    are distributed, and allows for infinite ones (Conover, "Practical Nonparametric Statistics",
    3.2). An end is None where it is infinite; both are with fewer than six values, at 0.95.
    """
    in_order, tail = sorted(values), (1 - confidence) / 2
    # P(at most k of n values lie below the median) for each k; scipy.stats takes a second to import
    shares = scipy.special.bdtr(range(len(in_order)), len(in_order), 0.5)
    largest = np.count_nonzero(shares <= tail) - 1
    if largest < 0:
        return None, None
    low, high = in_order[largest], in_order[-1 - largest]
    return (int(low) if np.isfinite(low) else None, int(high) if np.isfinite(high) else None)


def _median(values: Sequence[float]) -> float | None:
    """Return the median; None if it is infinite."""
    middle = sorted(values)[(len(values) - 1) // 2 : len(values) // 2 + 1]
    mean = sum(middle) / len(middle)
    return float(mean) if np.isfinite(mean) else None
