"""Worlds drawn from the whole configuration render without error, black ground, grain or holes.

`python test/helpers/judge_worlds.py --worlds 500 --out DIR` draws as many as you like.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from blender_process import in_blender
from drawn_worlds import drawn_world, make_files
from numpy.typing import NDArray
from world_judge import SPECKLE, grains, standing_out

from oaisys_core.config import config_from_mapping

EVERY_DAY = (184,)
"""Far away, patches of three layers are narrower than a pixel is long."""

SOAK = [range(first, first + 3) for first in range(11, 41, 3)]

SOME, MANY = range(40), range(300)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the textures, heights and skies of drawn worlds."""
    folder = tmp_path_factory.mktemp("drawn_worlds")
    make_files(folder)
    return folder


def check(seeds: Sequence[int], files: Path) -> None:
    """Fail with each world's faults, and the world itself as YAML."""
    found = in_blender("drawn.verdicts", list(seeds), files)
    bad = {seed: verdict.faults for seed, verdict in found.items() if verdict.faults}
    worlds = [yaml.safe_dump(drawn_world(seed, files), sort_keys=False) for seed in bad]
    assert not bad, "\n".join([*(f"seed {seed}: {bad[seed]}" for seed in bad), *worlds])


@pytest.mark.blender
def test_drawn_worlds_look_right(files: Path) -> None:
    check(EVERY_DAY, files)


@pytest.mark.soak
@pytest.mark.blender
@pytest.mark.parametrize("seeds", SOAK, ids=lambda seeds: f"{seeds[0]}-{seeds[-1]}")
def test_many_drawn_worlds_look_right(files: Path, seeds: range) -> None:
    check(seeds, files)


def test_drawn_worlds_are_valid_and_the_same_for_the_same_seed(files: Path) -> None:
    for seed in SOME:
        data = drawn_world(seed, files)
        assert data == drawn_world(seed, files)
        config_from_mapping(yaml.safe_load(yaml.safe_dump(data)))


def test_all_of_the_schema_is_drawn(files: Path) -> None:
    worlds = [drawn_world(seed, files) for seed in MANY]
    layers = [layer for world in worlds for layer in world["materials"]["layers"]]
    assert {len(world["materials"]["layers"]) for world in worlds} >= {1, 2, 3, 4, 8, 16}
    assert {layer["anti_tiling"] for layer in layers} == {"none", "voronoi", "stochastic"}
    assert any("folder" in layer and "tile_m" in layer for layer in layers)
    for section, keys in {
        "stage": {"preset", "dem", "mesh", "water", "detail", "surroundings"},
        "materials": {"pools", "projection", "label_borders", "displacement", "variation"},
        "assets": {"objects", "movers", "primitives", "rock_texture"},
        "environment": {"haze", "clouds", "hdri", "lamps", "optical_depth", "ground_beyond"},
        "sensors": {"stereo", "motion"},
        "render": {"effects", "camera_look", "view_transform", "exposure_ev", "auto_exposure"},
    }.items():
        assert keys <= {key for world in worlds for key in world[section]}, section


SMOOTH = np.linspace(40, 200, 64).astype(np.uint8)[None, :, None] * np.ones((48, 64, 3), np.uint8)
PLACES = np.arange(4, 44, 8)[:, None], np.arange(4, 60, 8)


def with_grain(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image, some of whose pixels are brighter."""
    grainy = image.copy()
    grainy[PLACES] += 40
    return grainy


def noisy(image: NDArray[np.uint8], level: float, seed: int) -> NDArray[np.uint8]:
    """Return an image with noise of a standard deviation."""
    noise = np.random.default_rng(seed).normal(0, level, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def test_grain_stands_out_and_gradients_do_not() -> None:
    assert (standing_out(SMOOTH) < SPECKLE).all()
    found = standing_out(with_grain(SMOOTH)) > SPECKLE
    assert found[PLACES].all()
    assert found.sum() == found[PLACES].size


def test_texture_that_the_denoiser_has_smeared_is_no_grain() -> None:
    textured = noisy(SMOOTH, 20, seed=0)
    smeared = cv2.GaussianBlur(textured, (3, 3), 0)
    assert grains(textured, smeared, ()).mean() > 0.01
    pair = [noisy(textured, 2, seed) for seed in (1, 2)]
    assert grains(textured, smeared, pair).mean() < 0.001


@pytest.mark.parametrize("level", [0.0, 2.0, 30.0])
def test_noise_of_the_pictures_to_compare_with_hides_no_grain(level: float) -> None:
    pair = [noisy(SMOOTH, level, seed) for seed in (1, 2)]
    found = grains(with_grain(SMOOTH), SMOOTH, pair)
    assert found[PLACES].mean() > 0.9
    assert found.sum() == found[PLACES].sum()
