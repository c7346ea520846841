"""Variation of colour from metres to kilometres: unbiased, reproducible, and no tile in it."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.macro_variation import BRIGHTNESS, TINT, MacroPattern


def test_it_neither_brightens_nor_tints_the_ground() -> None:
    macro = MacroPattern(1.0, 7)
    axis_m = np.arange(0.0, macro.period_m, 4.1)
    xy_m = np.stack(np.meshgrid(axis_m, axis_m), axis=-1).reshape(-1, 2)
    factors = macro.factors_at(xy_m)
    np.testing.assert_allclose(factors.mean(axis=0), 1, atol=2e-3)
    np.testing.assert_allclose(factors[:, 1].std(), BRIGHTNESS, rtol=0.1)
    tint = (factors[:, 0] - factors[:, 2]) / 2
    np.testing.assert_allclose(tint.std(), TINT, rtol=0.1)
    np.testing.assert_allclose(factors, macro.factors_at(xy_m + macro.period_m), atol=1e-4)


def test_it_varies_at_every_scale() -> None:
    macro = MacroPattern(0.5, 7)
    deviations = []
    for step_m in (4.0, 16.0, 64.0, 256.0):
        xy_m = np.random.default_rng(1).uniform(0, macro.period_m, (4000, 2))
        change = macro.factors_at(xy_m + np.array((step_m, 0))) - macro.factors_at(xy_m)
        deviations.append(change[:, 1].std())
    assert (np.diff(deviations) > 0.005).all(), deviations
    assert deviations[0] > 0.01


def test_it_is_drawn_from_its_seed_and_scales_with_its_strength() -> None:
    one, same, other = (MacroPattern(0.5, seed).share for seed in (1, 1, 2))
    assert one.tobytes() == same.tobytes()
    assert (one != other).mean() > 0.5
    full = MacroPattern(1.0, 1).share.astype(float)
    np.testing.assert_allclose(full.std(), 2 * one.astype(float).std(), rtol=0.05)
