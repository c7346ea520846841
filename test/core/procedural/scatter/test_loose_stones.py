"""Patches of stones: their sizes against the law of the texture, their places and colours."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.config.sections.layers import LooseStones
from oaisys_core.procedural.scatter.loose_stones import (
    LOOSE_STONES,
    StonePatch,
    make_stone_patch,
    stone_colors,
)
from oaisys_core.procedural.textures.baking.sizes import RosinRammler
from oaisys_core.procedural.textures.library import TEXTURES
from oaisys_core.scene import MeshPrototype, PbrMaps

GREY = np.full((1, 3), 0.2)
KINDS = [(name, kind) for name, kinds in LOOSE_STONES.items() for kind in kinds]


def draw(kind: StonePatch, seed: int = 1) -> MeshPrototype:
    return make_stone_patch("stones", kind, GREY, np.random.default_rng(seed))


def boxes_m(kind: StonePatch, seed: int = 1) -> NDArray[np.float64]:
    """Return the (N, 2, 3) lowest and highest corners of the stones of a patch."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    mesh = draw(kind, seed)
    a, b, c = mesh.triangles.T
    rows, columns = np.concatenate((a, b)), np.concatenate((b, c))
    size = len(mesh.vertices_m)
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size))
    count, stone = connected_components(graph, directed=False)
    points_m = mesh.vertices_m * np.mean(kind.width_m)
    return np.array(
        [
            (points_m[stone == each].min(axis=0), points_m[stone == each].max(axis=0))
            for each in range(count)
        ]
    )


def test_the_configuration_names_the_stones_that_there_are() -> None:
    assert set(get_args(LooseStones)) == {"none", *LOOSE_STONES}
    assert LOOSE_STONES.keys() <= set(TEXTURES)


@pytest.mark.parametrize(("name", "kind"), KINDS)
def test_stones_lie_on_the_ground_within_their_patch(name: str, kind: StonePatch) -> None:
    boxes = boxes_m(kind)
    low, high = boxes[:, 0], boxes[:, 1]
    # Each is partly below the ground and partly above it.
    assert (low[:, 2] < 0).all()
    assert (high[:, 2] > 0).all()
    reach_m = np.abs(boxes[..., :2]).max()
    assert 0.3 * np.mean(kind.width_m) < reach_m < 0.6 * np.mean(kind.width_m)
    longest_m = (high - low).max(axis=1)
    assert longest_m.max() < 1.35 * kind.size_m[1]
    assert longest_m.min() > 0.5 * kind.size_m[0]


def test_sizes_follow_the_law_of_crushed_stone() -> None:
    # Of the area of stones from 2 to 12 cm, the share above 4 cm by Rosin and Rammler's law.
    law = RosinRammler(0.035, 0.9)
    kind = StonePatch(1.0, (2.0, 2.0), 0.0, "angular", 0.3, (0.02, 0.12), law)
    boxes = boxes_m(kind)
    extent_m = (boxes[:, 1] - boxes[:, 0]).max(axis=1)
    above = np.exp(-((np.array((0.02, 0.04, 0.12)) / 0.035) ** 0.9))
    expected = (above[1] - above[2]) / (above[0] - above[2])
    share = (extent_m[extent_m > 0.04] ** 2).sum() / (extent_m**2).sum()
    assert share == pytest.approx(expected, abs=0.08)


def test_stones_mostly_do_not_lie_in_each_other() -> None:
    boxes = boxes_m(LOOSE_STONES["pebbles"][0])
    middle = boxes[:, :, :2].mean(axis=1)
    radius = (boxes[:, 1, :2] - boxes[:, 0, :2]).min(axis=1) / 2
    gap = np.linalg.norm(middle[:, None] - middle, axis=-1) - 0.7 * (radius[:, None] + radius)
    np.fill_diagonal(gap, 1.0)
    assert (gap < 0).any(axis=1).mean() < 0.25


def test_the_same_seed_draws_the_same_patch() -> None:
    kind = LOOSE_STONES["gravel"][0]
    one, other = draw(kind, 3), draw(kind, 3)
    assert one.vertices_m.tobytes() == other.vertices_m.tobytes()
    assert draw(kind, 4).vertices_m.tobytes() != one.vertices_m.tobytes()


def test_stones_have_the_colours_of_what_stands_out_of_the_texture() -> None:
    # Grey stones, a third of the area, lie higher than the brown ground.
    pixels = np.full((256, 256, 3), (120, 90, 60), np.uint8)
    height = np.zeros((256, 256), np.float32)
    pixels[:, :110], height[:, :110] = 150, 0.9
    normal = np.full((256, 256, 3), (128, 128, 255), np.uint8)
    maps = PbrMaps("mixed", pixels, height, normal, np.full((256, 256), 200, np.uint8), 2.0)
    colors = stone_colors(maps)
    np.testing.assert_allclose(colors, linear(150 / 255), atol=1e-6)
    patch = make_stone_patch("stones", LOOSE_STONES["gravel"][1], colors, np.random.default_rng(5))
    assert patch.vertex_colors_srgb is not None
    mean = linear(patch.vertex_colors_srgb / 255).mean(axis=0)
    np.testing.assert_allclose(mean, linear(150 / 255), rtol=0.03)


def test_a_small_texture_has_colours_too() -> None:
    pixels = np.full((16, 16, 3), 100, np.uint8)
    flat = np.full((16, 16), 0.5, np.float32)
    maps = PbrMaps("small", pixels, flat, pixels, np.full((16, 16), 200, np.uint8), 1.0)
    np.testing.assert_allclose(stone_colors(maps), linear(100 / 255), atol=1e-6)
