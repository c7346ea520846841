"""Ribbons laid over a tile, seen from above."""

from typing import Any

import numpy as np

from oaisys_core.procedural.textures.recipes import strokes
from oaisys_core.procedural.textures.recipes.strokes import RibbonLayer, Ribbons

SIZE = 64


def ribbon(row: float, column: float, **changed: Any) -> Ribbons:
    """One flat ribbon towards larger columns, 20 long and 6 wide; changes are lists of numbers."""
    given: dict[str, Any] = {
        "root": np.array([[row, column]]),
        "heading": [0.0],
        "length": [20.0],
        "width": [6.0],
        "bend": [0.0],
        "low": [1.0],
        "rise": [0.0],
        "outline": strokes.level,
        "arch": strokes.level,
    }
    given.update(changed)
    values: dict[str, Any] = {
        k: np.asarray(v) if isinstance(v, list) else v for k, v in given.items()
    }
    return Ribbons(**values)


def test_a_straight_ribbon_covers_its_rectangle() -> None:
    ribbon_layer = RibbonLayer(SIZE, 4.0)
    ribbon_layer.lay(ribbon(32.0, 10.0))
    expected = np.zeros((SIZE, SIZE), bool)
    expected[29:35, 10:30] = True
    assert (ribbon_layer.ids >= 0).tolist() == expected.tolist()
    assert np.allclose(ribbon_layer.height_px[expected], 1.0, atol=1e-4)
    assert (ribbon_layer.height_px[~expected] == 0).all()
    along, across = ribbon_layer.along[32, 10:30], ribbon_layer.across[29:35, 15]
    assert np.allclose(along, (np.arange(20) + 0.5) / 20, atol=0.03)
    assert np.allclose(across, (np.arange(6) - 2.5) / 3, atol=0.17)


def test_a_ribbon_goes_around_the_tile() -> None:
    ribbon_layer = RibbonLayer(SIZE, 4.0)
    ribbon_layer.lay(ribbon(0.0, 54.0))
    rows, columns = np.nonzero(ribbon_layer.ids >= 0)
    assert set(rows) == {0, 1, 2, 61, 62, 63}
    assert set(columns) == {*range(54, 64), *range(10)}


def test_heading_turns_from_columns_to_rows() -> None:
    ribbon_layer = RibbonLayer(SIZE, 4.0)
    ribbon_layer.lay(ribbon(10.0, 32.0, heading=[np.pi / 2]))
    rows, columns = np.nonzero(ribbon_layer.ids >= 0)
    assert (rows.min(), rows.max()) == (10, 29)
    assert (columns.min(), columns.max()) == (29, 34)


def test_the_highest_is_seen_whatever_the_order() -> None:
    for order in ((1.0, 3.0), (3.0, 1.0)):
        ribbon_layer = RibbonLayer(SIZE, 4.0)
        ribbon_layer.lay(ribbon(32.0, 10.0, low=[order[0]]))
        ribbon_layer.lay(ribbon(22.0, 20.0, heading=[np.pi / 2], low=[order[1]]))
        assert ribbon_layer.count == 2
        assert set(np.unique(ribbon_layer.ids)) == {-1, 0, 1}
        assert ribbon_layer.ids[32, 20] == int(np.argmax(order))
        assert np.isclose(ribbon_layer.height_px[32, 20], 3.0, atol=1e-4)


def test_many_at_once_are_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    many = Ribbons(
        rng.uniform(0, SIZE, (40, 2)),
        rng.uniform(0, 6, 40),
        np.full(40, 12.0),
        np.full(40, 3.0),
        rng.uniform(-0.3, 0.3, 40),
        rng.uniform(0, 2, 40),
        rng.uniform(0, 2, 40),
        strokes.blade,
        strokes.arc,
    )
    together, single = RibbonLayer(SIZE, 5.0), RibbonLayer(SIZE, 5.0)
    together.lay(many)
    for k in range(40):
        part = {name: getattr(many, name)[k : k + 1] for name in Ribbons._fields[:7]}
        single.lay(many._replace(**part))
    assert np.array_equal(together.ids, single.ids)
    assert np.array_equal(together.height_px, single.height_px)


def test_an_arc_rises_and_hangs_over() -> None:
    ribbon_layer = RibbonLayer(SIZE, 8.0)
    ribbon_layer.lay(ribbon(32.0, 10.0, low=[0.5], rise=[6.0], arch=strokes.arc))
    profile = ribbon_layer.height_px[32, 10:30]
    highest = int(np.argmax(profile))
    assert 10 < highest < 18
    assert profile[0] < 1.2
    assert profile[-1] < profile[highest] - 0.5


def test_outlines_taper() -> None:
    t = np.linspace(0, 1, 101, dtype=np.float32)
    for outline in (strokes.blade, strokes.leaf):
        half = outline(t)
        assert half.min() >= 0
        assert half.max() <= 1.0001
        assert half[-1] < 0.06
