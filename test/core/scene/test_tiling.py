"""Tilings: weights, continuity, and labels that follow the texture, against OpenCV's remap."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.scene import PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.scene.terrain_material import LabelImage, grain_numbers
from oaisys_core.scene.tiling import PlainTiling, Tiling, stochastic_tiling, voronoi_tiling

TILE_M = 1.7
EXTENT_M = (-20.0, -20.0, 20.0, 20.0)


def tilings() -> dict[str, Tiling]:
    rng = np.random.default_rng(1)
    return {
        "none": PlainTiling(),
        "voronoi": voronoi_tiling(1.3, np.pi, rng),
        "stochastic": stochastic_tiling(0.8, rng),
    }


def maps() -> PbrMaps:
    grey = np.full((4, 4), 128, np.uint8)
    colour = np.stack([grey] * 3, axis=-1)
    return PbrMaps("a", colour, np.zeros((4, 4), np.float32), colour, grey, TILE_M)


def points(count: int = 4000) -> NDArray[np.float64]:
    return np.random.default_rng(5).uniform(-19, 19, (count, 2))


@pytest.mark.parametrize("name", ["none", "voronoi", "stochastic"])
def test_weights_sum_to_one_and_mixtures_have_no_seam(name: str) -> None:
    tiling, xy = tilings()[name], points()
    samples = tiling.samples(xy)
    assert np.allclose(samples.weights.sum(axis=0), 1)
    assert samples.weights.min() >= 0

    def mixed(at: NDArray[np.float64]) -> NDArray[np.float64]:
        samples = tiling.samples(at)
        places, weights = samples.uv_tiles, samples.weights
        wave = np.cos(2 * np.pi * places).sum(axis=-1)
        return np.asarray((weights * wave).sum(axis=0))

    step = abs(mixed(xy + 1e-4) - mixed(xy))
    # The wave changes by at most 4 pi a tile, the weights by a few times that across a cell.
    assert step.max() < 1e-4 * 60


def test_cells_are_turned_and_shifted() -> None:
    xy = points()
    voronoi = tilings()["voronoi"].samples(xy)
    own = voronoi.weights[0] > 0.99
    assert own.mean() > 0.3
    near = voronoi.uv_tiles[0][own] - tilings()["voronoi"].samples(xy[own] + (1e-6, 0)).uv_tiles[0]
    angle = np.arctan2(-near[:, 1], -near[:, 0])
    assert np.histogram(angle, 4, (-np.pi, np.pi))[0].min() > 0.1 * own.sum()


@pytest.mark.parametrize("name", ["none", "voronoi", "stochastic"])
def test_labels_of_an_image_follow_the_texture(name: str) -> None:
    image = np.random.default_rng(2).integers(1, 9, (24, 40)).astype(np.uint16)
    layer = TerrainLayer("a", (50, 60), maps(), tilings()[name], LabelImage(image[None]))
    material = TerrainMaterial((layer,), np.ones((1, 8, 8), np.float32), EXTENT_M)
    xy = points()
    samples = layer.tiling.samples(xy / TILE_M)
    place = samples.uv_tiles[samples.weights.argmax(axis=0), np.arange(len(xy))]
    # OpenCV's nearest pixel to texel coordinates, the image upside down as v points upwards.
    u, v = (place % 1).T
    texel = np.column_stack((u * 40 - 0.5, 24 - v * 24 - 0.5)).astype(np.float32)
    expected = cv2.remap(
        image, texel[:, :1], texel[:, 1:], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )[:, 0]
    # OpenCV rounds to nearest with fixed-point numbers: leave the pixels' edges out.
    clear = (abs((texel + 0.5) % 1 - 0.5) < 0.46).all(axis=1)
    assert clear.mean() > 0.7
    assert (material.semantic_ids_at(xy) == expected)[clear].all()
    assert (material.semantic_ids_at(xy, 1) == 0).all()
    assert layer.all_semantic_ids == {50, 60, *range(1, 9)}


def test_soft_labels_are_as_frequent_as_layers_weigh() -> None:
    names = ("a", "b", "c")
    layers = tuple(TerrainLayer(n, (i + 1,), maps()) for i, n in enumerate(names))
    weights = np.array([0.2, 0.5, 0.3], np.float32)
    masks = np.broadcast_to(weights[:, None, None], (3, 8, 8)).astype(np.float32)
    soft = TerrainMaterial(layers, masks, EXTENT_M, label_cell_m=0.05)
    xy = np.random.default_rng(0).uniform(-20, 20, (200_000, 2))
    ids = soft.semantic_ids_at(xy)
    assert np.allclose(np.bincount(ids, minlength=4)[1:] / len(ids), weights, atol=0.005)
    assert (soft.semantic_ids_at(xy[::-1])[::-1] == ids).all(), "the same from any view"
    hard = TerrainMaterial(layers, masks, EXTENT_M)
    assert (hard.semantic_ids_at(xy) == 2).all()


def test_a_grain_has_one_number_and_neighbours_differ() -> None:
    cells = np.stack(np.meshgrid(np.arange(-150, 150), np.arange(-150, 150)), -1).reshape(-1, 2)
    numbers = grain_numbers((cells + 0.5) * 0.02, 0.02)
    inside = grain_numbers(
        (cells + np.random.default_rng(0).uniform(0.01, 0.99, cells.shape)) * 0.02, 0.02
    )
    assert (numbers == inside).all()
    assert (numbers >= 0).all()
    assert (numbers < 1).all()
    assert np.histogram(numbers, 10, (0, 1))[0].min() > 0.95 * len(numbers) / 10
    square = numbers.reshape(300, 300)
    for other in (np.roll(square, 1, 0), np.roll(square, 1, 1), np.roll(square, (1, 1), (0, 1))):
        assert abs(np.corrcoef(square.ravel(), other.ravel())[0, 1]) < 0.015
