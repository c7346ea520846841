"""Presets made by processes: the same bytes each time, and figures of geomorphology."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from oaisys_core.procedural.terrain.presets import SHAPED, make_ground
from tools.gallery.geomorphometry import concavity, crater_exponents, measure

DIGESTS = {
    "alpine": "69af944422b276a1",
    "badlands": "d30d5b46b6b8f9ab",
    "canyon": "73d2c161e7efd7f6",
    "crater_field": "e80f6146d4707292",
    "mesa": "73b7be811b11c0ed",
    "mountain_1": "baee871f58b884d5",
    "river_bed": "3d9904567413ee10",
    "slab_dunes": "feab3fa7ee1e6661",
    "volcanic_field": "aff3087c994374a8",
}
"""Of grounds of 97 points, on both Pythons; all that processes made are here."""


@pytest.mark.parametrize("preset", sorted(DIGESTS))
def test_a_preset_has_the_same_bytes_on_each_run_and_python(
    preset: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert SHAPED.keys() <= DIGESTS.keys()
    monkeypatch.setenv("OAISYS_CACHE_MB", "0")
    ground = make_ground(preset, 100.0, 97, np.random.default_rng(3))
    assert ground.elevation_m.shape == (97, 97)
    assert ground.elevation_m.dtype == np.float32
    assert ground.extent_m == pytest.approx((-50, -50, 50, 50))
    assert np.isfinite(ground.elevation_m).all()
    assert hashlib.sha256(ground.elevation_m.tobytes()).hexdigest()[:16] == DIGESTS[preset]


@pytest.mark.parametrize("preset", sorted(SHAPED.keys() - {"slab_dunes"}))
@pytest.mark.parametrize(("extent_m", "relief_m"), [(0.01, None), (64.0, 0.0), (1e7, None)])
def test_a_preset_has_finite_heights_at_the_bounds_of_its_keys(
    preset: str, extent_m: float, relief_m: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OAISYS_CACHE_MB", "0")
    rng = np.random.default_rng(0)
    assert np.isfinite(make_ground(preset, extent_m, 9, rng, relief_m=relief_m).elevation_m).all()


@pytest.mark.long
def test_badlands_have_the_concavity_of_rivers_and_slopes_at_repose() -> None:
    ground = make_ground("badlands", 100.0, 385, np.random.default_rng(3))
    found = measure(ground)
    assert 0.35 <= found.concavity <= 0.6
    assert 0.3 <= found.hypsometric_integral <= 0.7
    assert 25.0 < found.slope_deg[1] < 42.0


@pytest.mark.long
def test_alpine_ground_has_the_concavity_of_rivers() -> None:
    # The seed of 1 to 5 that had the least one before rivers had more time.
    ground = make_ground("alpine", 120.0, 769, np.random.default_rng(2))
    assert 0.35 <= measure(ground).concavity <= 0.6


def test_the_concavity_of_a_power_law_is_its_exponent() -> None:
    area = np.geomspace(10, 1e5, 5000)
    assert concavity(area, 3.0 * area**-0.5) == pytest.approx(0.5, abs=0.01)


def test_craters_have_the_exponents_of_production_and_equilibrium() -> None:
    small, large = crater_exponents()
    assert small == pytest.approx(-2.0, abs=0.15)
    assert large == pytest.approx(-3.0, abs=0.3)


@pytest.mark.parametrize("seed", [3, 8])
def test_rims_of_cones_are_not_level(seed: int) -> None:
    ground = make_ground("volcanic_field", 150.0, 301, np.random.default_rng(seed))
    below_m = ground.elevation_m.max() - ground.elevation_m
    relief_m = float(np.median(below_m))
    # Of an even cone with a crater 0.35 as wide as its base, it would be an eighth.
    assert (below_m < 0.08 * relief_m).sum() < 0.1 * (below_m < 0.35 * relief_m).sum()
