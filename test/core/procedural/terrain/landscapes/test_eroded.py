"""Erosion of presets and elevation models, and grounds kept on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from oaisys_core.config.sections.erosion import BedsConfig, ErosionConfig
from oaisys_core.config.sections.stage import StageConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.landscapes import kept as keeping
from oaisys_core.procedural.terrain.landscapes.eroded import erode_ground
from oaisys_core.procedural.terrain.presets import make_ground
from oaisys_core.scene import HeightField


def ground(size_px: int = 97, preset: str = "mounds") -> HeightField:
    return make_ground(preset, 64.0, size_px, np.random.default_rng(1), relief_m=9.0)


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OAISYS_CACHE_MB", "0")


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize("beds", [None, BedsConfig()])
def test_any_preset_erodes_into_the_same_bytes_each_time(beds: BedsConfig | None) -> None:
    before, config = ground(), ErosionConfig(age=0.1, beds=beds)
    one, other = (erode_ground(before, config, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.elevation_m, other.elevation_m)
    change_m = one.elevation_m - before.elevation_m
    assert change_m.min() < -0.3
    assert np.isfinite(change_m).all()
    other_seed = erode_ground(before, config, np.random.default_rng(4))
    assert not np.array_equal(one.elevation_m, other_seed.elevation_m)


@pytest.mark.usefixtures("no_cache")
@pytest.mark.parametrize("shape", [(2, 2), (3, 40), (2, 300)])
def test_narrow_grids_erode(shape: tuple[int, int]) -> None:
    heights = np.random.default_rng(0).random(shape).astype(np.float32)
    config = ErosionConfig(beds=BedsConfig())
    after = erode_ground(HeightField(heights, (0.0, 0.0), 1.0), config, np.random.default_rng(0))
    assert np.isfinite(after.elevation_m).all()


@pytest.mark.usefixtures("no_cache")
def test_an_elevation_model_keeps_its_means_over_pixels() -> None:
    before = ground(161)
    pixel = 8
    after = erode_ground(
        before, ErosionConfig(age=0.2), np.random.default_rng(3), pixel * before.spacing_m
    )
    change_m = (after.elevation_m - before.elevation_m)[:160, :160].astype(float)
    means_m = change_m.reshape(20, pixel, 20, pixel).mean(axis=(1, 3))
    assert change_m.std() > 0.02
    assert np.abs(means_m).mean() < 0.15 * change_m.std()


def test_erosion_below_the_posting_wants_a_finer_grid() -> None:
    before = ground()
    with pytest.raises(InvalidInputError, match="ground_spacing_m of at most two thirds"):
        erode_ground(before, ErosionConfig(), np.random.default_rng(0), before.spacing_m)


def test_a_ground_is_made_once_and_read_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made: list[int] = []

    def make() -> np.ndarray:
        made.append(1)
        return np.arange(12.0).reshape(3, 4)

    for _ in range(3):
        heights = keeping.make_once("test", ("a", 1), np.random.default_rng(0), make)
        assert np.array_equal(heights, np.arange(12.0, dtype=np.float32).reshape(3, 4))
    assert len(made) == 1
    keeping.make_once("test", ("a", 2), np.random.default_rng(0), make)
    keeping.make_once("test", ("a", 1), np.random.default_rng(1), make)
    assert len(made) == 3
    for file in tmp_path.rglob("*.npz"):
        file.write_bytes(b"damaged")
    keeping.make_once("test", ("a", 1), np.random.default_rng(0), make)
    assert len(made) == 4


def test_a_kept_ground_depends_on_all_code_that_makes_it() -> None:
    assert {"procedural/terrain/landscapes", "procedural/terrain/processes"} <= set(keeping.CODE)


def test_meshes_do_not_erode_and_hard_rock_is_steeper(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("")
    with pytest.raises(ValueError, match="only grids erode"):
        StageConfig.model_validate({"mesh": {"file": str(tmp_path / "a.obj")}, "erosion": {}})
    with pytest.raises(ValueError, match=r"beds.repose_deg: received 20, expected at least"):
        ErosionConfig.model_validate({"beds": {"repose_deg": 20.0}})
