"""Plants with fewer triangles look as dense as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oaisys_core.procedural.meshes.thinning import LARGEST_FACTOR, thin_out
from oaisys_core.procedural.scatter.rocks import make_rock
from oaisys_core.procedural.scatter.shapes import make_shape
from oaisys_core.scene import MeshPrototype


def area(plant: MeshPrototype) -> float:
    a, b, c = np.moveaxis(plant.vertices_m[plant.triangles].astype(np.float64), 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def covered(plant: MeshPrototype, cells: int = 24) -> float:
    """Return the share of square cells, seen from the side, that have a vertex in them."""
    rows = np.floor(plant.vertices_m[:, 2] * cells).astype(int)
    columns = np.floor(plant.vertices_m[:, 0] * cells).astype(int)
    return len(np.unique(1000 * rows + columns)) / cells**2


@pytest.mark.parametrize(("shape", "grown_m"), [("spruce", 9.0), ("birch", 7.0), ("willow", 2.0)])
def test_a_tree_keeps_its_leaves_area_and_its_outline(shape: str, grown_m: float) -> None:
    tree = make_shape(shape, np.random.default_rng(1), grown_m, None, grown_m)
    thin = thin_out(tree, 8_000, np.random.default_rng(2))

    assert len(thin.triangles) < 0.45 * len(tree.triangles)
    assert area(thin) == pytest.approx(area(tree), rel=0.1)
    assert covered(thin) > 0.75 * covered(tree)
    size_m, before_m = (np.ptp(each.vertices_m, axis=0) for each in (thin, tree))
    assert size_m == pytest.approx(before_m, rel=0.3)
    assert thin.triangles.max() == len(thin.vertices_m) - 1
    colors, before = thin.vertex_colors_srgb, tree.vertex_colors_srgb
    assert colors is not None
    assert before is not None
    assert thin.translucency is not None
    assert len(colors) == len(thin.translucency) == len(thin.vertices_m)
    assert colors.mean(axis=0) == pytest.approx(before.mean(axis=0), abs=25)


def test_leaves_are_at_most_so_much_larger() -> None:
    tree = make_shape("birch", np.random.default_rng(1), 7.0, None, 7.0)
    thin = thin_out(tree, 1, np.random.default_rng(2))
    leaves = len(tree.triangles) / LARGEST_FACTOR**2
    assert len(thin.triangles) > 0.9 * leaves


def test_what_has_few_triangles_no_leaves_or_textures_stays() -> None:
    rng = np.random.default_rng(1)
    rock = make_rock("angular", rng, 3)
    fern = make_shape("fern", rng)
    textured = replace(fern, uv=np.zeros((len(fern.triangles), 3, 2), np.float32))
    assert thin_out(rock, 10, rng) is rock
    assert thin_out(fern, 10_000, rng) is fern
    assert thin_out(textured, 10, rng) is textured
