"""A sample's time budget, by machines whose costs are given: how near to it the views come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np
import pytest

from oaisys_core.render.blender.time_budget import (
    DenoisingQuality,
    TimeBudget,
    ViewCost,
    ViewPlan,
    denoising_quality_for,
    lowest_quality,
)

PIXELS = 640 * 480
MAX_SAMPLES = 128


@dataclass
class Machine:
    """Takes light samples of its own cost until the time for them is over, as Cycles does."""

    preparing_s: float = 0.05
    sample_s: float = 0.25
    finishing_s: float = 0.2
    balanced_s: float = 0.4
    thorough_s: float = 0.9

    def render(
        self, plan: ViewPlan, denoise_as: Callable[[int, float], DenoisingQuality] | None = None
    ) -> ViewCost:
        """Return what a view costs; at full size, each sample takes ``sample_s``.

        ``denoise_as`` decides of the samples and the seconds until then; None: as planned.
        """
        pixels = round(PIXELS * plan.scale**2)
        one_s = self.sample_s * plan.scale**2
        samples = 1
        while samples < MAX_SAMPLES and (not plan.sampling_s or samples * one_s < plan.sampling_s):
            samples += 1
        until_s = self.preparing_s + samples * one_s
        denoising = plan.denoising if denoise_as is None else denoise_as(samples, until_s)
        taken_s = {"fast": self.finishing_s, "balanced": self.balanced_s}
        finishing_s = taken_s.get(denoising, self.thorough_s) * plan.scale**2
        return ViewCost(pixels, samples, self.preparing_s, samples * one_s, finishing_s, denoising)


def taken_s(cost: ViewCost) -> float:
    return cost.preparing_s + cost.sampling_s + cost.finishing_s


def taught(machine: Machine, views: int = 3) -> TimeBudget:
    budget = TimeBudget()
    for _ in range(views):
        budget.learn(machine.render(budget.plan(PIXELS, 2.0)))
    return budget


@pytest.mark.parametrize("seconds", [1.5, 3.0, 6.0])
def test_views_of_very_different_cost_come_within_15_percent(seconds: float) -> None:
    rng = np.random.default_rng(3)
    budget = taught(Machine())
    for sample_s in rng.uniform(0.1, 0.3, 40).tolist():
        cost = Machine(sample_s=sample_s).render(budget.plan(PIXELS, seconds))
        budget.learn(cost)
        assert taken_s(cost) == pytest.approx(seconds, rel=0.15)


def test_a_budget_that_changes_with_each_view_is_met_each_time() -> None:
    budget = taught(Machine())
    for seconds in (6.0, 1.5, 3.0, 1.5, 6.0, 2.0):
        cost = Machine().render(budget.plan(PIXELS, seconds))
        budget.learn(cost)
        assert taken_s(cost) == pytest.approx(seconds, rel=0.15)


@pytest.mark.parametrize("seconds", [0.15, 0.25, 0.4])
def test_less_time_than_a_sample_of_each_pixel_takes_means_fewer_pixels(seconds: float) -> None:
    plan = taught(Machine()).plan(PIXELS, seconds)
    cost = Machine().render(plan)
    assert plan.scale < 1
    assert cost.samples == 1
    assert taken_s(cost) == pytest.approx(seconds, rel=0.15)


def test_a_view_that_took_long_to_prepare_does_not_move_what_follows() -> None:
    budget = taught(Machine(), views=5)
    before = budget.plan(PIXELS, 2.0)
    budget.learn(Machine(preparing_s=30.0).render(before))
    assert budget.plan(PIXELS, 2.0) == before


def test_a_changed_world_is_expected_to_take_as_long_as_the_last_time() -> None:
    steady, fresh = Machine(), Machine(preparing_s=1.0)
    budget = TimeBudget()
    budget.learn(fresh.render(budget.plan(PIXELS, 3.0)))
    for _ in range(3):
        budget.learn(steady.render(budget.plan(PIXELS, 3.0)))
    budget.world_changed()
    assert taken_s(fresh.render(budget.plan(PIXELS, 3.0))) == pytest.approx(3.0, rel=0.15)


def test_the_first_view_has_one_sample() -> None:
    plan = TimeBudget().plan(PIXELS, 100.0)
    assert Machine().render(plan).samples == 1
    assert plan.scale == 1


def test_no_budget_is_no_limit() -> None:
    assert taught(Machine()).plan(PIXELS, inf) == ViewPlan(
        scale=1.0, sampling_s=0.0, denoising="thorough"
    )
    assert Machine().render(ViewPlan(1.0, 0.0)).samples == MAX_SAMPLES


def test_time_that_is_over_already_gives_the_smallest_image() -> None:
    plan = taught(Machine()).plan(PIXELS, -1.0)
    assert plan.scale == pytest.approx(0.25)


def test_the_more_samples_fit_the_more_goes_into_denoising() -> None:
    budget = taught(Machine(sample_s=0.25))
    assert budget.plan(PIXELS, 0.8).denoising == "fast"
    assert budget.plan(PIXELS, 2.0).denoising == "balanced"
    assert budget.plan(PIXELS, 4.0).denoising == "thorough"
    assert budget.plan(PIXELS, inf).denoising == "thorough"


@pytest.mark.parametrize("thorough_s", [0.5, 2.0])
def test_what_thorough_denoising_takes_is_learned(thorough_s: float) -> None:
    machine = Machine(thorough_s=thorough_s)
    budget = taught(machine)
    for _ in range(3):
        budget.learn(machine.render(budget.plan(PIXELS, 6.0)))
    assert taken_s(machine.render(budget.plan(PIXELS, 6.0))) == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize(
    ("samples", "denoising"), [(1, "fast"), (3, "balanced"), (8, "thorough"), (128, "thorough")]
)
def test_few_samples_are_not_worth_much_denoising(
    samples: int, denoising: DenoisingQuality
) -> None:
    assert denoising_quality_for(samples) == denoising


def test_the_least_of_two_efforts() -> None:
    assert lowest_quality("thorough", "balanced") == lowest_quality("balanced", "thorough")
    assert lowest_quality("fast", "balanced") == "fast"


@pytest.mark.parametrize(
    ("samples", "left_s", "denoising"),
    [
        (2, 0.2, "fast"),
        (2, 0.4, "balanced"),
        (2, 5.0, "balanced"),
        (9, 5.0, "thorough"),
        (9, 0.75, "thorough"),
        (9, -1.0, "fast"),
    ],
)
def test_denoising_takes_the_time_that_light_samples_leave(
    samples: int, left_s: float, denoising: DenoisingQuality
) -> None:
    budget = taught(Machine())
    for each in (2.0, 6.0):
        budget.learn(Machine().render(budget.plan(PIXELS, each)))
    assert budget.denoising_quality(PIXELS, samples, left_s, 4.0) == denoising


@pytest.mark.parametrize("pixels", [PIXELS, PIXELS // 16])
def test_an_effort_that_took_long_once_is_tried_again(pixels: int) -> None:
    """It loads what it needs the first time, in a small picture, too."""
    budget = taught(Machine())
    budget.learn(
        ViewCost(pixels, 1, 0.05, 0.25 * pixels / PIXELS, 2.0 * pixels / PIXELS, "balanced")
    )
    assert budget.denoising_quality(PIXELS, 2, 0.45, 2.0) == "balanced"


def test_the_second_view_does_not_wait_for_a_world_as_the_first_did() -> None:
    budget = TimeBudget()
    budget.learn(Machine(preparing_s=2.0).render(budget.plan(PIXELS, 2.0)))
    assert taken_s(Machine().render(budget.plan(PIXELS, 2.0))) == pytest.approx(2.0, rel=0.15)


def test_the_first_view_is_denoised_quickly() -> None:
    assert TimeBudget().denoising_quality(PIXELS, 9, 100.0, 100.0) == "fast"


def test_light_samples_of_a_third_of_the_budget_come_within_15_percent() -> None:
    rng = np.random.default_rng(4)
    seconds = 2.0
    machine = Machine(sample_s=0.6, finishing_s=0.2, balanced_s=0.4, thorough_s=1.2)
    budget = taught(machine)

    def denoise_as(samples: int, until_s: float) -> DenoisingQuality:
        return budget.denoising_quality(PIXELS, samples, seconds - until_s, seconds)

    for sample_s in rng.uniform(0.5, 0.7, 60).tolist():
        view = replace(machine, sample_s=sample_s)
        cost = view.render(budget.plan(PIXELS, seconds), denoise_as)
        budget.learn(cost)
        assert taken_s(cost) == pytest.approx(seconds, rel=0.15)


def test_what_was_computed_beside_one_sample_is_not_expected_of_each() -> None:
    alone, beside = TimeBudget(), TimeBudget()
    cost = Machine(sample_s=0.6).render(ViewPlan(1.0, 1e-3))
    longer = replace(cost, sampling_s=cost.sampling_s + 0.1, beside_s=0.1)
    for _ in range(3):
        alone.learn(cost)
        beside.learn(longer)
    expected, plan = alone.plan(PIXELS, 5.0), beside.plan(PIXELS, 5.0)
    # It ends as early as without, and the clock of light samples runs while it is computed.
    assert plan.sampling_s == pytest.approx(expected.sampling_s, abs=1e-9)
    assert beside.plan(PIXELS, 0.9).scale < alone.plan(PIXELS, 0.9).scale
