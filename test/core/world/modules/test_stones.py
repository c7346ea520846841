"""Stones that a texture shows have labels of their own, by choice, where its pixels show them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from oaisys_core import randomness
from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.layers import LayerConfig
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.textures.label_image import label_stones
from oaisys_core.procedural.textures.library import RECIPES, make_texture_set
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata
from oaisys_core.world.modules.layers import check_layers

GROUND, STONE, COARSE = 1, 7, 40
TILE_M, SIZE_PX, MIN_SIZE_M = 2.8, 128, 0.07

GRAVEL: dict[str, Any] = {
    "texture": "gravel",
    "label": "gravel",
    "semantic_id": GROUND,
    "levels": [{"label": "loose", "semantic_id": 30}],
    "stones": {
        "label": "stone",
        "semantic_id": STONE,
        "levels": [{"label": "coarse", "semantic_id": COARSE}],
        "min_size_m": MIN_SIZE_M,
    },
}

WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {
        "surroundings": "plain",
        "preset": "mounds",
        "extent_m": 12.0,
        "resolution_px": 33,
        "relief_m": 0.5,
    },
    "materials": {
        "layers": [GRAVEL],
        "texture_size_px": SIZE_PX,
        "projection": "top",
        "mask": {"size_px": 16, "relief": 0},
    },
    "assets": {"rocks": []},
    "environment": {"ground_beyond": False},
    "sensors": {
        "cameras": [
            {
                "width_px": 64,
                "height_px": 48,
                "modalities": ["depth", "semantic_0", "semantic_1", "instance"],
            }
        ],
        "motion": {"kind": "hover", "height_above_ground_m": [1.5, 2.0]},
    },
}


def stones_of_gravel() -> NDArray[np.uint32]:
    made = RECIPES["gravel"].make(SIZE_PX, randomness.stream(0, "texture/gravel"))
    assert made.stones is not None
    return made.stones


def expected_ids(xy_m: NDArray[np.float64], shift_px: float = 0.0) -> NDArray[np.int64]:
    """Return the ids at (N, 2) points by the numbers of the stones alone."""
    stones = stones_of_gravel()
    numbers, counts = np.unique(stones, return_counts=True)
    areas_m2 = counts * (TILE_M / SIZE_PX) ** 2
    large = numbers[(numbers > 0) & (4 * areas_m2 / np.pi >= MIN_SIZE_M**2)]
    texel = (xy_m / TILE_M % 1.0) * SIZE_PX + shift_px
    column, up = np.floor(texel).astype(int).T % SIZE_PX
    return np.where(np.isin(stones[SIZE_PX - 1 - up, column], large), STONE, GROUND)


def test_labels_are_those_of_the_stones_at_the_points_that_pixels_show() -> None:
    """Points by depth, K and pose in numpy; the mask is looked up by its definition."""
    simulation = Simulation(config_from_mapping(WORLD))
    simulation.step_batch()
    pose = pose_looking_at((1.3, -1.7, 3.0), (2.4, -0.6, 0.0))
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    depth, labels, coarse = (
        sample.frame("camera", name) for name in ("depth", "semantic_0", "semantic_1")
    )
    simulation.close()
    rows, columns = np.nonzero(np.isfinite(depth.data))
    pixels = np.stack((columns, rows, np.ones_like(rows)))
    in_camera_m = np.linalg.inv(depth.intrinsics.K) @ pixels * depth.data[rows, columns]
    points_m = depth.T_map_camera[:3, :3] @ in_camera_m + depth.T_map_camera[:3, 3:]
    found = labels.data[rows, columns]
    assert np.isin(found, (GROUND, STONE)).all()
    assert 0.05 < (found == STONE).mean() < 0.9
    # Depth is of 32 bits: a point within a hundredth of a texel of its border may be beyond it.
    around = [expected_ids(points_m[:2].T, shift) for shift in (-0.01, 0.0, 0.01)]
    is_clear = (around[0] == around[1]) & (around[1] == around[2])
    assert is_clear.mean() > 0.95
    assert (found[is_clear] == around[1][is_clear]).all()
    other = coarse.data[rows, columns]
    assert (other == np.where(found == STONE, COARSE, 30)).all()


def test_stones_of_the_mask_are_what_the_maps_show() -> None:
    """A stone stands above the ground around it, in the height map that was made with it."""
    stones = stones_of_gravel()
    height = make_texture_set("gravel", SIZE_PX, 0).height
    numbers, counts = np.unique(stones[stones > 0], return_counts=True)
    large = np.isin(stones, numbers[counts > 15])
    around = np.zeros_like(large)
    for axis in (0, 1):
        for step in (-2, 2):
            around |= np.roll(large, step, axis)
    around &= ~large
    assert 0.02 < large.mean() < 0.6
    assert height[large].mean() > height[around].mean() + 0.1


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(RECIPES))
def test_a_recipe_makes_stones_if_and_only_if_it_says_so(name: str) -> None:
    stones = RECIPES[name].make(256, np.random.default_rng(1)).stones
    assert (stones is not None) == RECIPES[name].has_stones
    if stones is not None:
        assert stones.dtype == np.uint32
        assert stones.shape == (256, 256)
        assert (stones > 0).any()


def test_a_stone_counts_from_the_size_of_the_area_that_it_shows() -> None:
    stones = np.zeros((100, 100), np.uint32)
    stones[:10, :10] = 3  # 1 m2 of a tile of 10 m: as a circle of 1.128 m
    stones[50:55, 95:] = stones[50:55, :15] = 5  # over the seam: 1 m2 as well
    stones[80:85, 50:55] = 9  # a quarter
    by_least = {
        least: label_stones(stones, 10.0, least, (STONE,), (GROUND, 30)).semantic_ids
        for least in (1.12, 1.13, 0.5)
    }
    assert set(np.unique(stones[by_least[1.12][0] == STONE])) == {3, 5}
    assert (by_least[1.13][0] == GROUND).all()
    assert set(np.unique(stones[by_least[0.5][0] == STONE])) == {3, 5, 9}
    assert (by_least[0.5][1] == 30).all()


def test_stones_are_ground_by_default() -> None:
    assert LayerConfig(texture="gravel", label="gravel", semantic_id=1).stones is None


REFUSED = [
    (
        {"texture": "basalt"},
        InvalidInputError,
        r"layers\.0\.texture.*basalt.*with stones: .*gravel",
    ),
    (
        {"stones": {**GRAVEL["stones"], "semantic_id": GROUND}},
        InvalidInputError,
        r"layers\.0\.semantic_id.*name 'gravel' already",
    ),
    ({"stones": {**GRAVEL["stones"], "min_size_m": 0}}, ValidationError, "min_size_m"),
]


@pytest.mark.parametrize(("change", "error", "message"), REFUSED)
def test_what_cannot_be_is_refused(
    change: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        check_layers(MaterialsConfig.model_validate({"layers": [GRAVEL | change]}), "materials")


def test_a_layer_has_one_source_of_labels(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    labels = {"image": str(tmp_path / "a.png"), "mapping": {"1": {"label": "a", "semantic_id": 3}}}
    with pytest.raises(ValidationError, match="received labels_from and stones"):
        LayerConfig.model_validate(GRAVEL | {"labels_from": labels})
    with pytest.raises(ValidationError, match="received folder and stones"):
        LayerConfig.model_validate(GRAVEL | {"folder": str(tmp_path)})


@pytest.mark.blender
@pytest.mark.long
def test_blender_gives_the_same_labels_and_the_check_agrees(tmp_path: Path) -> None:
    from blender_process import in_blender
    from small_datasets import render_dataset

    from oaisys_dataset import open_dataset
    from oaisys_dataset.check import check_dataset

    in_blender("datasets.render", str(tmp_path / "blender"), {0: "train"}, 2, WORLD)
    render_dataset(tmp_path / "analytic", {0: "train"}, 2, WORLD)
    ours, theirs = (list(open_dataset(tmp_path / name)) for name in ("analytic", "blender"))
    for a, b in zip(ours, theirs, strict=True):
        for modality in ("semantic_0", "semantic_1"):
            assert np.array_equal(a.arrays[modality], b.arrays[modality])
        assert {GROUND, STONE} <= set(np.unique(a.arrays["semantic_0"]).tolist())
    assert open_dataset(tmp_path / "blender").legend(0).labels[STONE] == "stone"
    report = check_dataset(tmp_path / "blender", worlds_rebuilt=1)
    assert report.findings == ()
    assert any(each.modality == "semantic_0" and each.pixels > 1000 for each in report.audited)
