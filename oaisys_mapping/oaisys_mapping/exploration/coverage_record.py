"""How planners came on, and what each of them needed over all worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CoverageRecord:
    """How one planner came on in one world.

    Attributes:
        planner: Its name.
        seed: Of the world.
        coverage: Share of the reachable surface that was seen, after each view.
        path_m: Length flown until each view.
        plan_s: Median time to find the next view.
        refused: Poses that the simulator refused.
        least_clearance_m: The least height above the true surface of any pose; NaN: not known.
    """

    planner: str
    seed: int
    coverage: Sequence[float]
    path_m: Sequence[float]
    plan_s: float
    refused: int = 0
    least_clearance_m: float = float("nan")

    def views_to(self, share: float) -> int | None:
        """Return how many views it took to see so much; None: it never did."""
        reached = np.flatnonzero(np.asarray(self.coverage) >= share)
        return int(reached[0]) + 1 if len(reached) else None


@dataclass(frozen=True)
class PlannerResult:
    """What a planner needed to see a share of what can be reached, over all worlds.

    Attributes:
        planner: Its name.
        worlds: How many it explored.
        reached: In how many it got there.
        views: Median of the views it took; None: it got there in less than half of the worlds.
        fewest_views, most_views: Over the worlds where it got there.
        more_than_views: Where there is no median: the median of the views after which it gave up,
            or had to; it needs more.
        path_m: Median length flown until then.
        final_coverage: Median of what it saw in the end.
        plan_s: Median time to find a view.
        refused: Poses that the simulator refused, in all worlds.
        least_clearance_m: The least height above the true surface of any pose.
    """

    planner: str
    worlds: int
    reached: int
    views: float | None
    fewest_views: int | None
    most_views: int | None
    more_than_views: float | None
    path_m: float | None
    final_coverage: float
    plan_s: float
    refused: int
    least_clearance_m: float


def planner_results(records: Sequence[CoverageRecord], share: float) -> list[PlannerResult]:
    """Return each planner's result, in the order of their first records."""
    names = dict.fromkeys(record.planner for record in records)
    return [_result([r for r in records if r.planner == name], share) for name in names]


def _result(records: Sequence[CoverageRecord], share: float) -> PlannerResult:
    views = [record.views_to(share) for record in records]
    there = [count for count in views if count is not None]
    paths_m = [
        np.inf if count is None else record.path_m[count - 1]
        for record, count in zip(records, views, strict=True)
    ]
    median_views = _median([np.inf if count is None else count for count in views])
    given_up = float(np.median([len(record.coverage) for record in records]))
    return PlannerResult(
        planner=records[0].planner,
        worlds=len(records),
        reached=len(there),
        views=median_views,
        fewest_views=min(there, default=None),
        most_views=max(there, default=None),
        more_than_views=given_up if median_views is None else None,
        path_m=_median(paths_m),
        final_coverage=float(np.median([record.coverage[-1] for record in records])),
        plan_s=float(np.median([record.plan_s for record in records])),
        refused=sum(record.refused for record in records),
        least_clearance_m=float(np.min([record.least_clearance_m for record in records])),
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median; None where it is infinite."""
    middle = sorted(values)[(len(values) - 1) // 2 : len(values) // 2 + 1]
    mean = sum(middle) / len(middle)
    return float(mean) if np.isfinite(mean) else None
