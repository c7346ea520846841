"""Blades cast from above, and the swards and moss that are made of them."""

from typing import Any

import numpy as np
import pytest

from oaisys_core.procedural.textures.baking import blades as shapes
from oaisys_core.procedural.textures.baking.blades import Blades, cast_blades

SIZE = 128


def even(along: np.ndarray) -> np.ndarray:
    return np.ones_like(along)


def strip(**changed: Any) -> Blades:
    """A lying strip in the middle, half a tile long towards larger columns, a tenth wide."""
    given: dict[str, Any] = {
        "foot": [[0.5, 0.25, 0.02]],
        "heading": [0.0],
        "length": [0.5],
        "width": [0.1],
        "lean": [np.pi / 2],
        "droop": [0.0],
        "sway": [0.0],
    }
    given.update(changed)
    values: dict[str, Any] = {
        name: np.array(value, float) for name, value in given.items() if name != "outline"
    }
    return Blades(**values, outline=given.get("outline", even))


def texel_places() -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of texels' centres in tile edges."""
    row, column = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    return row, column


def test_a_lying_strip_covers_its_rectangle() -> None:
    view = cast_blades([strip()], SIZE)
    row, column = texel_places()
    expected = (np.abs(row - 0.5) < 0.05) & (np.abs(column - 0.5) < 0.25)
    assert np.array_equal(view.ids == 0, expected)
    assert (view.ids[~expected] == -1).all()
    assert (view.height[~expected] == -np.inf).all()
    assert np.allclose(view.height[expected], 0.02, atol=1e-6)
    assert np.allclose(view.along[expected], (column[expected] - 0.25) / 0.5, atol=1e-4)
    assert np.allclose(np.abs(view.across[expected]), np.abs(row[expected] - 0.5) / 0.05, atol=1e-3)
    assert np.allclose(view.facing[expected], 1)


def test_it_goes_on_across_the_edges() -> None:
    """Moved by parts of a tile, its picture is moved as much."""
    start = cast_blades([strip()], SIZE)
    moved = cast_blades([strip(foot=[[0.0, 0.75, 0.02]])], SIZE)
    for one, two in zip(start, moved, strict=True):
        assert np.allclose(np.roll(one, (SIZE // 2, SIZE // 2), (0, 1)), two, atol=1e-4)


@pytest.mark.parametrize("heading", [0.0, np.pi / 2, 2.0])
def test_a_leaning_one_rises_along_its_heading(heading: float) -> None:
    lean = 1.0
    blade = strip(foot=[[0.5, 0.5, 0.02]], heading=[heading], lean=[lean], width=[0.125])
    view = cast_blades([blade], SIZE)
    row, column = texel_places()
    seen = view.ids == 0
    out = np.sin(heading) * (row - 0.5) + np.cos(heading) * (column - 0.5)
    assert np.allclose(view.height[seen], 0.02 + out[seen] / np.tan(lean), atol=1e-4)
    assert np.isclose(out[seen].max(), 0.5 * np.sin(lean), atol=0.01)
    assert np.allclose(view.facing[seen], np.sin(lean))
    # Its area, seen from above.
    assert np.isclose(seen.mean(), 0.5 * np.sin(lean) * 0.125, rtol=0.03)


def test_the_highest_is_seen_in_any_order_of_groups() -> None:
    low, high = strip(), strip(foot=[[0.5, 0.25, 0.05]], width=[0.04])
    for groups, upper in (([low, high], 1), ([high, low], 0)):
        view = cast_blades(groups, SIZE)
        assert set(np.unique(view.ids)) == {-1, 0, 1}
        assert view.ids[SIZE // 2, SIZE // 2] == upper


def test_a_drooping_one_bends_over() -> None:
    arc = strip(lean=[0.2], droop=[2.2], length=[0.3])._replace(segments=12)
    view = cast_blades([arc], SIZE)
    profile = view.height[SIZE // 2]
    profile = profile[np.isfinite(profile)]
    highest = int(profile.argmax())
    assert 3 < highest < len(profile) - 3
    assert profile[-1] < profile[highest] - 0.01
    assert profile[0] < profile[highest] - 0.05


@pytest.mark.parametrize(
    "outline",
    [shapes.grass_outline, shapes.leaf_outline, shapes.leaflet_outline, shapes.taper_outline],
)
def test_outlines_are_as_wide_as_said_and_end_in_a_tip(outline: shapes.Outline) -> None:
    half = outline(np.linspace(0, 1, 501))
    assert half.min() >= 0
    assert 0.95 < half.max() <= 1
    assert half[-1] < 1e-3


def random_blades(seed: int) -> Blades:
    rng = np.random.default_rng(seed)
    count = 300
    low, high = (0, 0, 0.02, 0.004, 0.1, 0.0, -0.4), (1, 7, 0.2, 0.02, 1.5, 1.0, 0.4)
    heading, length, width, lean, droop, sway = rng.uniform(low[1:], high[1:], (count, 6)).T
    foot = np.column_stack((rng.uniform(0, 1, (count, 2)), np.zeros(count)))
    return Blades(foot, heading, length, width, lean, droop, sway, shapes.grass_outline)


def test_equal_blades_give_equal_bytes_in_groups_or_not() -> None:
    group = random_blades(1)
    whole = cast_blades([group], SIZE)
    parts = []
    for some in (slice(150), slice(150, None)):
        values: Any = {name: getattr(group, name)[some] for name in Blades._fields[:7]}
        parts.append(group._replace(**values))
    for one, two in zip(whole, cast_blades(parts, SIZE), strict=True):
        assert one.tobytes() == two.tobytes()


def test_blades_too_narrow_to_be_seen_are_joined() -> None:
    assert shapes.blades_as_one(0.001, 2048) == 1
    assert np.isclose(shapes.blades_as_one(0.001, 250), 2)
    assert shapes.blades_as_one(0.0001, 16) == shapes.MOST_AS_ONE
