"""Fines at the feet of things."""

from dataclasses import replace

import numpy as np
from synthetic_worlds import flat_world

from oaisys_core.procedural.contact_map import ContactMap, contact_map
from oaisys_core.procedural.scatter.rocks import make_rock
from oaisys_core.procedural.scatter.vehicles import VEHICLES
from oaisys_core.scene import MeshPrototype, Placement, Scene, WheelTracks

ROCK = make_rock("boulder", np.random.default_rng(0), 2)


def world(rock: MeshPrototype = ROCK, is_moving: bool = False) -> Scene:
    """A boulder of 2 m whose base is 0.3 m deep in level ground, at (4, -3)."""
    T = np.diag((2.0, 2.0, 2.0, 1.0))
    T[:3, 3] = (4.0, -3.0, 0.25 - 0.3)
    placement = Placement(0, (10,), T[None], np.array([1], np.uint32), is_moving)
    return replace(flat_world(), prototypes=(rock,), placements=(placement,))


def values(contact: ContactMap, x_m: float, y_m: float) -> int:
    x0, y0, x1, _ = contact.extent_m
    texel_m = (x1 - x0) / len(contact.share)
    return int(contact.share[int((y_m - y0) / texel_m), int((x_m - x0) / texel_m)])


def test_fines_lie_around_a_rock_and_nowhere_else() -> None:
    contact = contact_map(world())
    assert contact is not None
    assert values(contact, 4.0, -3.0) == 255
    assert values(contact, 6.5, -3.0) == 0
    row = contact.share[[int((-3.0 + 20.0) / 40 * len(contact.share))]][0].astype(int)
    x_m = (np.arange(len(row)) + 0.5) / len(row) * 40 - 20
    rim_m = np.ptp(x_m[row > 0]) - np.ptp(x_m[row > 220])
    assert 0.1 < rim_m < 1.2, "both rims of a rock of 2 m"
    points = np.array([[[4.0, -3.0], [6.5, -3.0]]])
    assert contact.is_near(points).tolist() == [[True, False]]


def test_the_outline_is_that_of_the_rock_where_the_ground_cuts_it() -> None:
    contact = contact_map(world())
    assert contact is not None
    at_m = 0.3 / 2.0
    cut = ROCK.vertices_m[np.abs(ROCK.vertices_m[:, 2] - at_m) < 0.08] * 2
    rows, columns = np.nonzero(contact.share > 230)
    width_m = np.array((np.ptp(columns), np.ptp(rows))) * 40 / len(contact.share)
    assert np.allclose(width_m, np.ptp(cut[:, :2], axis=0), rtol=0.25)


def test_what_moves_or_is_clean_has_no_fines() -> None:
    assert contact_map(world(is_moving=True)) is None
    assert contact_map(world(replace(ROCK, dust_m=0.0))) is None
    assert contact_map(flat_world()) is None


def test_tracks_lie_where_wheels_pass_with_the_share_of_the_way() -> None:
    out = np.array([(-8.0, 2.0), (8.0, 2.0)])
    there_and_back = np.vstack((out, [(8.0, 8.0), (0.0, 8.0), (0.0, -8.0)]))
    tracks = (WheelTracks(out, 0.7, 0.3, 0.2), WheelTracks(there_and_back, 0.7, 0.3, 0.2))
    contact = contact_map(replace(flat_world(), tracks=tracks))
    assert contact is not None
    assert contact.passed is not None
    shares = contact.passed

    def passed(x_m: float, y_m: float) -> list[int]:
        texel_m = 40 / len(shares)
        return shares[int((y_m + 20) / texel_m), int((x_m + 20) / texel_m)].tolist()

    for side in (-0.7, 0.7):
        assert abs(passed(0.0, 2.0 + side)[0] - 128) <= 2, "half of the way"
        assert passed(-7.5, 2.0 + side)[0] < 12
    assert passed(0.0, 2.0) == [0, 0, 0], "between the wheels"
    first = 255 * 8.0 / 46.0
    assert abs(passed(0.7, 2.0 + 0.7)[1] - first) < 8, "crossed again later"
    assert passed(0.0, -19.0) == [0, 0, 0]


def test_a_lander_has_fines_at_its_pads_only() -> None:
    lander = VEHICLES["lander"]()
    placement = Placement(0, (10,), np.eye(4)[None] + 0.0, np.array([1], np.uint32))
    placement.T_map_object[0, 2, 3] = 0.25
    contact = contact_map(replace(flat_world(), prototypes=(lander,), placements=(placement,)))
    assert contact is not None
    assert values(contact, 1.31, 1.31) == 255
    assert values(contact, 0.0, 0.0) == 0
