"""The tone of the ground: dark where it is damp, pale on crests, even at the stage's edge."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.masks.tone import StageTone
from oaisys_core.scene import HeightField
from oaisys_core.scene.terrain_material import MAX_TONE, MIN_TONE, Variation

SIZE = 128


def valley() -> HeightField:
    """A valley along y, of 60 m, that falls to the south."""
    axis = np.linspace(-30, 30, 121)
    x, y = np.meshgrid(axis, axis)
    return HeightField((6 * np.abs(np.sin(x / 19)) + 0.1 * y).astype(np.float32), (-30, -30), 0.5)


def factors(
    green: bool = False,
    snowy: bool = False,
    brightness: float = 0.35,
    tint: float = 0.0,
    seed: int = 0,
) -> NDArray[np.float64]:
    masks = np.ones((1, SIZE, SIZE), np.float32)
    made = StageTone(valley(), masks, (green,), (snowy,), Variation(brightness, tint), seed).pixels
    assert made.dtype == np.uint8
    return MIN_TONE + made * ((MAX_TONE - MIN_TONE) / 255)


def test_hollows_are_dark_and_crests_pale() -> None:
    by_column = factors()[20:-20].mean(axis=(0, 2))
    assert by_column[60:68].mean() < 0.95, "the valley's floor"
    assert by_column[16:24].mean() > 1.02, "its crest"


def test_the_mean_is_kept_and_the_edge_is_even() -> None:
    found = factors()
    assert found.mean() == pytest.approx(1, abs=0.02)
    for edge in (found[0], found[-1], found[:, 0], found[:, -1]):
        np.testing.assert_allclose(edge, 1, atol=0.03)


def test_strength_is_that_of_the_configuration() -> None:
    weak, strong = (factors(brightness=each) for each in (0.1, 0.3))
    assert strong.std() == pytest.approx(3 * weak.std(), rel=0.1)
    tinted = factors(brightness=0.0, tint=0.4)
    assert (tinted[..., 0] - 1).std() > 0.03
    np.testing.assert_allclose(tinted[..., 0] - 1, 1 - tinted[..., 2], atol=0.03)


def test_plants_are_yellow_where_it_is_dry_and_have_dark_clumps() -> None:
    found = factors(green=True)
    yellow = (found[..., 0] / found[..., 1])[20:-20]
    assert yellow[:, 16:24].mean() > 1.1 * yellow[:, 60:68].mean()
    bare = factors()[20:-20, 60:68, 1]
    clumping = found[20:-20, 60:68, 1]
    dark, dark_bare = ((each < 0.75 * np.median(each)).mean() for each in (clumping, bare))
    assert dark > 0.03 > 2 * dark_bare


def test_snow_is_clean() -> None:
    """Its tone was that of earth: stains as of dirt."""
    assert factors(snowy=True).std() < 0.2 * factors().std()


def test_it_is_drawn_from_the_generator_alone() -> None:
    assert factors().tobytes() == factors().tobytes()
    assert factors().tobytes() != factors(seed=1).tobytes()
