"""Where water runs, against a priority flood and planes of known direction."""

from __future__ import annotations

import heapq

import numpy as np
import pytest

from oaisys_core.procedural.terrain.processes.flow import edge_cells, route
from oaisys_core.procedural.terrain.processes.stream_power import fill_depressions


def rough(size: int = 48, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (size, size))


def flooded(z: np.ndarray) -> np.ndarray:
    """Return the level of water by a priority flood (Barnes et al. 2014)."""
    level = np.full(z.shape, np.inf)
    heap = [(z[r, c], r, c) for r, c in np.argwhere(edge_cells(z.shape))]
    for height, r, c in heap:
        level[r, c] = height
    heapq.heapify(heap)
    while heap:
        height, r, c = heapq.heappop(heap)
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                i, j = r + dr, c + dc
                if 0 <= i < len(z) and 0 <= j < len(z) and np.isinf(level[i, j]):
                    level[i, j] = max(height, z[i, j])
                    heapq.heappush(heap, (level[i, j], i, j))
    return level


@pytest.mark.parametrize("seed", range(4))
def test_water_leaves_depressions_over_their_lowest_passes(seed: int) -> None:
    z = rough(seed=seed)
    flow = route(z, 1.0, np.random.default_rng(seed))
    assert np.array_equal(fill_depressions(z, flow), flooded(z))


def test_all_water_reaches_an_outlet_once() -> None:
    z = rough()
    flow = route(z, 1.0, np.random.default_rng(1))
    area = flow.accumulate(np.ones(z.size))
    assert area[: flow.bounds[1]].sum() == z.size
    assert np.array_equal(np.sort(flow.order), np.arange(z.size))
    assert (flow.receiver[flow.bounds[1] :] < np.arange(flow.bounds[1], z.size)).all()


def test_water_may_leave_at_chosen_cells_only() -> None:
    z = rough()
    outlets = np.zeros(z.shape, bool)
    outlets[3, 5] = True
    flow = route(z, 1.0, None, outlets)
    assert flow.accumulate(np.ones(z.size))[0] == z.size


@pytest.mark.parametrize("heading_deg", [0.0, 10.0, 22.5, 37.0, 45.0, 80.0])
def test_water_runs_straight_down_on_the_average(heading_deg: float) -> None:
    size = 96
    axis = np.arange(size, dtype=float)
    heading = np.radians(heading_deg)
    z = -(axis[None, :] * np.cos(heading) + axis[:, None] * np.sin(heading))
    flow = route(z, 1.0, np.random.default_rng(0))
    inner = flow.bounds[1]
    here, there = flow.order[inner:], flow.order[flow.receiver[inner:]]
    step = np.stack((there % size - here % size, there // size - here // size), 1)
    mean = step.mean(axis=0)
    assert np.degrees(np.arctan2(mean[1], mean[0])) == pytest.approx(heading_deg, abs=1.0)


def test_the_same_seed_gives_the_same_ways() -> None:
    z = rough()
    one, other = (route(z, 1.0, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.order, other.order)
    assert np.array_equal(one.receiver, other.receiver)
