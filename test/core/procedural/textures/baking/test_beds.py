"""Things cast from above and laid over a tile."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from oaisys_core.procedural.scatter.rocks import icosphere
from oaisys_core.procedural.textures.baking.bed import Bed, Laying
from oaisys_core.procedural.textures.baking.sizes import PowerLaw, RosinRammler, draw_diameters
from oaisys_core.procedural.textures.baking.stamps import (
    OUTSIDE,
    MeshStamps,
    cast_from_above,
    cast_rocks,
    cast_stamps,
)
from oaisys_core.types import TriangleMesh

SIZE = 256
FLAT_OUT = Laying(buried=(0.0, 0.0), makes_room=False)


def ball() -> TriangleMesh:
    points, triangles = icosphere(5)
    return TriangleMesh(3.0 + 0.2 * points, triangles)


@pytest.fixture(scope="module")
def ball_stamps() -> MeshStamps:
    return cast_stamps([ball()])


def bed_of(stamps: MeshStamps, diameters: list[float], laying: Laying, seed: int = 0) -> Bed:
    bed = Bed(np.zeros((SIZE, SIZE), np.float32))
    bed.add(stamps, np.array(diameters), laying, np.random.default_rng(seed))
    return bed


def test_a_ball_is_cast_as_its_upper_half() -> None:
    heights = cast_from_above(ball(), 64)
    axis = (np.arange(64) + 0.5) / 32 - 1
    square = axis[:, None] ** 2 + axis[None, :] ** 2
    inside = square < 0.98
    assert np.allclose(heights[inside], 1 + np.sqrt(1 - square[inside]), atol=0.01)
    assert (heights[square > 1.001] == OUTSIDE).all()


def test_a_plate_is_seen_the_right_way_up() -> None:
    """A triangle with its right angle at the smallest x and y, tilted up towards +y."""
    plate = TriangleMesh(
        np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 1.0]]),
        np.array([[0, 1, 2]], np.int32),
    )
    heights = cast_from_above(plate, 32)
    row, column = np.mgrid[:32, :32]
    x, y = (column + 0.5) / 16, 2 - (row + 0.5) / 16
    inside = x + y < 1.99
    assert np.allclose(heights[inside], y[inside] / 2, atol=1e-5)
    assert (heights[x + y > 2.01] == OUTSIDE).all()


@pytest.mark.parametrize("diameter", [0.04, 0.3], ids=["small", "large"])
def test_a_ball_on_a_tile_is_a_ball(ball_stamps: MeshStamps, diameter: float) -> None:
    bed = bed_of(ball_stamps, [diameter], FLAT_OUT, seed=3)
    placed = bed.placements
    # Its disc has the area of one of that diameter.
    radius = float(placed.radius_px[0])
    assert abs(radius / SIZE - diameter / 2) < 0.02 * diameter
    axis = np.arange(SIZE) + 0.5
    away = [(axis - c + SIZE / 2) % SIZE - SIZE / 2 for c in placed.centre[0]]
    square = (away[0][:, None] ** 2 + away[1][None, :] ** 2) / radius**2
    inside = square < 0.7
    expected = (1 + np.sqrt(1 - square[inside])) * radius / SIZE
    assert np.allclose(bed.height[inside], expected, atol=0.14 * radius / SIZE)
    assert (bed.ids[square < 0.7] == 0).all()
    assert (bed.ids[square > 1.5] == -1).all()
    assert (bed.height[bed.ids < 0] == 0).all()


def test_what_is_buried_rises_less(ball_stamps: MeshStamps) -> None:
    top = [bed_of(ball_stamps, [0.3], Laying(buried=(b, b))).height.max() for b in (0.0, 0.25, 0.5)]
    # A ball of diameter d rises by (1 - b) * d.
    assert np.allclose(np.array(top) / top[0], (1, 0.75, 0.5), atol=0.02)


def test_a_later_thing_lies_on_an_earlier_one(ball_stamps: MeshStamps) -> None:
    bed = bed_of(ball_stamps, [0.9], FLAT_OUT)
    below = bed.height.copy()
    bed.add(ball_stamps, np.full(20, 0.1), FLAT_OUT, np.random.default_rng(1))
    assert (bed.height >= below).all()
    assert bed.count == 21
    assert bed.height.max() > below.max() + 0.05


def test_things_make_room_for_larger_ones(ball_stamps: MeshStamps) -> None:
    """As wide as each other on a tile with half of it taken."""
    taken = {}
    for makes_room in (False, True):
        bed = bed_of(ball_stamps, [0.7], FLAT_OUT)
        largest = int((bed.ids == 0).sum())
        laying = Laying(buried=(0.0, 0.0), makes_room=makes_room)
        bed.add(ball_stamps, np.full(60, 0.06), laying, np.random.default_rng(1))
        taken[makes_room] = 1 - int((bed.ids == 0).sum()) / largest
    assert taken[True] < 0.3 * taken[False]
    assert taken[False] > 0.1


def test_density_keeps_things_where_it_is_high(ball_stamps: MeshStamps) -> None:
    density = np.zeros((SIZE, SIZE), np.float32)
    density[: SIZE // 2] = 1
    bed = Bed(np.zeros((SIZE, SIZE), np.float32))
    bed.add(ball_stamps, np.full(100, 0.03), FLAT_OUT, np.random.default_rng(4), density)
    covered = bed.ids >= 0
    assert covered[10 : SIZE // 2 - 10].mean() > 0.08
    assert not covered[SIZE // 2 + 10 : -10].any()


def test_edges_of_the_tile_cut_nothing() -> None:
    """Its seam is like any other row, and what lies across it is in one piece."""
    stamps = cast_rocks("angular")
    bed = bed_of(stamps, [0.12] * 30 + [0.03] * 200, Laying())
    for axis in (0, 1):
        inside = np.abs(np.diff(bed.height, axis=axis)).mean(axis=1 - axis)
        seam = np.abs(bed.height.take(0, axis) - bed.height.take(-1, axis)).mean()
        assert seam < inside.mean() + 3 * inside.std()
    placed = bed.placements
    centre = placed.centre[bed.ids]
    row, column = np.mgrid[:SIZE, :SIZE] + 0.5
    half = SIZE / 2
    away = np.hypot(
        (row - centre[..., 0] + half) % SIZE - half, (column - centre[..., 1] + half) % SIZE - half
    )
    limit = 1.5 * placed.radius_px[bed.ids] + 2
    assert (away < limit)[bed.ids >= 0].all()


def test_local_places_are_those_of_the_thing() -> None:
    """A plate that rises along its own y, turned: height and local y are the same."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 1], [-1, 1, 1]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    plate = cast_stamps([TriangleMesh(corners, triangles)])
    bed = bed_of(plate, [0.4], Laying(buried=(-0.5, -0.5)), seed=2)
    x, y = bed.local_places()
    seen = (bed.ids == 0) & (np.abs(x) < 0.9) & (np.abs(y) < 0.9)
    assert seen.sum() > 1000
    slope, _ = np.polyfit(y[seen], bed.height[seen], 1)
    assert np.isclose(slope, bed.placements.radius_px[0] / SIZE / 2, rtol=0.02)
    assert np.corrcoef(y[seen], bed.height[seen])[0, 1] > 0.999
    assert abs(np.corrcoef(x[seen], bed.height[seen])[0, 1]) < 0.02


def test_sizes_follow_rosin_and_rammler() -> None:
    law = RosinRammler(0.02, 1.2)
    low, high = 0.002, 0.1
    drawn = draw_diameters(law, 3.0, (low, high), np.random.default_rng(0))
    area = np.pi / 4 * drawn**2
    assert np.isclose(area.sum(), 3.0, rtol=0.05)
    assert (np.diff(drawn) <= 0).all()
    for diameter in (0.005, 0.01, 0.02, 0.04):
        retained = np.exp(-((np.array([diameter, low, high]) / 0.02) ** 1.2))
        expected = (retained[0] - retained[2]) / (retained[1] - retained[2])
        assert abs(area[drawn > diameter].sum() / area.sum() - expected) < 0.03


@pytest.mark.parametrize("exponent", [1.8, 2.0, 2.6])
def test_numbers_follow_a_power_law(exponent: float) -> None:
    drawn = draw_diameters(PowerLaw(exponent), 2.0, (0.002, 0.1), np.random.default_rng(0))
    above = [float((drawn > d).sum()) for d in (0.002, 0.004, 0.008)]
    tail = 0.1**-exponent
    expected = [d**-exponent - tail for d in (0.002, 0.004, 0.008)]
    assert np.allclose(np.array(above) / above[0], np.array(expected) / expected[0], atol=0.02)


def test_rocks_are_nearly_convex_and_lie_flat() -> None:
    stamps = cast_rocks("angular")
    for heights, share in zip(stamps.levels[0], stamps.share, strict=True):
        rows, columns = np.nonzero(heights > OUTSIDE)
        hull = ConvexHull(np.column_stack((rows, columns)))
        assert len(rows) > 0.9 * hull.volume
        assert 0.3 < share < 0.85
    assert np.median(stamps.top) < 2


@pytest.mark.parametrize("seed", [0, 7])
def test_equal_seeds_give_equal_beds(seed: int) -> None:
    stamps = cast_rocks("pebble")
    one, two = (bed_of(stamps, [0.1] * 20 + [0.02] * 100, Laying(), seed) for _ in range(2))
    assert one.height.tobytes() == two.height.tobytes()
    assert one.ids.tobytes() == two.ids.tobytes()
