"""The mantle of soil: it fills what is gentle, and leaves bare what is steep."""

import hashlib

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.processes.mantle import lay_mantle

SPACING_M = 0.25
REPOSE_DEG = 35.0


def rough_slope(slope_deg: float, seed: int = 0) -> NDArray[np.float64]:
    """A slope along x of 40 m with lumps of 0.5 m that are about 1 m wide."""
    rng = np.random.default_rng(seed)
    x_m = np.arange(161) * SPACING_M
    lumps_m = np.kron(rng.uniform(-0.5, 0.5, (41, 41)), np.ones((4, 4)))[:161, :161]
    return np.tan(np.radians(slope_deg)) * x_m + lumps_m


def roughness_m(elevation_m: NDArray[np.float64]) -> float:
    """Standard deviation of the second differences along a contour."""
    return float(np.diff(elevation_m[20:-20, 20:-20], n=2, axis=0).std())


def test_gentle_slopes_are_smooth_and_steep_ones_stay_rough() -> None:
    for slope_deg, least, most in ((5.0, 0.0, 0.35), (55.0, 0.99, 1.0)):
        rock_m = rough_slope(slope_deg)
        covered_m = lay_mantle(rock_m, SPACING_M, 1.0, (2.0, 1.0), REPOSE_DEG)
        assert least <= roughness_m(covered_m) / roughness_m(rock_m) <= most


def test_it_lies_on_the_rock_and_never_below() -> None:
    rock_m = rough_slope(20.0)
    covered_m = lay_mantle(rock_m, SPACING_M, 1.0, (2.0, 1.0), REPOSE_DEG)
    assert (covered_m >= rock_m).all()
    assert 0.5 < (covered_m > rock_m).mean() < 1.0, "most is covered, and rock stands out"
    assert (covered_m - rock_m).max() < 2.0


def test_lengths_that_the_grid_does_not_show_change_nothing() -> None:
    rock_m = rough_slope(10.0)
    assert (lay_mantle(rock_m, SPACING_M, 1.0, (0.3,), REPOSE_DEG) == rock_m).all()


def test_it_has_the_same_bytes_on_each_python() -> None:
    covered_m = lay_mantle(rough_slope(30.0), SPACING_M, 1.0, (2.0, 1.0), REPOSE_DEG)
    digest = hashlib.sha256(covered_m.astype(np.float32).tobytes()).hexdigest()[:16]
    assert digest == "6d08c5a7842f0dde"
