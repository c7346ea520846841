"""Label cells: accuracy beside steps, memory limit, files."""

from pathlib import Path

import numpy as np
import pytest
from synthetic_views import CAMERA, UP, camera_at, plane_depth_m, sphere_depth_m

from oaisys_core.types import FloatArray
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_mapping.voxels.block_layout import CELL_BLOCKS_PER_BLOCK, unique_blocks

GROUND, ROCK = 4, 9
RADIUS_M = 0.4
CONFIG = TsdfConfig(semantic=True)


def poses() -> list[FloatArray]:
    """Return four views down from 4 m, each past the rock on another side."""
    return [camera_at((x, y, 4), (x, y + 0.01, 0)) for x in (-1, 1) for y in (-1, 1)]


def look(volume: TsdfVolume, T: FloatArray, rock: int = ROCK) -> None:
    """Integrate a view of half a sphere on flat ground."""
    ground_m, rock_m = plane_depth_m(T, UP, 0.0), sphere_depth_m(T, RADIUS_M)
    labels = np.where(rock_m < ground_m, rock, GROUND).astype(np.uint16)
    volume.integrate(np.minimum(ground_m, rock_m), None, CAMERA, T, labels)


def on_rock(least_height_m: float) -> FloatArray:
    """Return points on the half sphere, evenly by its area (Archimedes)."""
    rng = np.random.default_rng(5)
    z, angle = rng.uniform(least_height_m, RADIUS_M, 4000), rng.uniform(0, 2 * np.pi, 4000)
    away = np.sqrt(RADIUS_M**2 - z**2)
    return np.column_stack((away * np.cos(angle), away * np.sin(angle), z))


def on_ground() -> FloatArray:
    """Return points of the ring of ground half a voxel to three voxels beside the rock."""
    rng = np.random.default_rng(6)
    away, angle = rng.uniform(RADIUS_M + 0.05, RADIUS_M + 0.3, 4000), rng.uniform(0, 7, 4000)
    return np.column_stack((away * np.cos(angle), away * np.sin(angle), np.zeros(4000)))


def test_classes_are_right_beside_a_step_smaller_than_a_voxel() -> None:
    volume = TsdfVolume(CONFIG)
    for T in poses():
        look(volume, T)
    rock, share = volume.classes_at(on_rock(0.05))
    ground, _ = volume.classes_at(on_ground())
    assert (rock == ROCK).mean() > 0.99
    assert (ground == GROUND).mean() > 0.99
    assert share.min() > 0.5
    assert share.max() <= 1


def test_a_saved_volume_returns_the_same_classes(tmp_path: Path) -> None:
    volume, loaded = TsdfVolume(CONFIG), TsdfVolume(CONFIG)
    for T in poses()[:2]:
        look(volume, T)
    volume.save(tmp_path / "volume.npz")
    loaded.load(tmp_path / "volume.npz")
    for T in poses()[2:]:
        look(volume, T)
        look(loaded, T)
    points_m = on_rock(0.0)
    labels, shares = loaded.classes_at(points_m)
    expected_labels, expected_shares = volume.classes_at(points_m)
    assert np.array_equal(labels, expected_labels)
    assert np.array_equal(shares, expected_shares)
    with np.load(tmp_path / "volume.npz") as arrays:
        blocks = len(arrays["cell_blocks"])
        assert arrays["cell_class_id"].shape == (blocks, 8, 8, 8, 2)
        assert set(np.unique(arrays["cell_class_id"]).tolist()) == {0, GROUND, ROCK}
        assert np.array_equal(arrays["cell_class_weight"] > 0, arrays["cell_class_id"] > 0)


def test_a_file_without_cells_falls_back_to_voxel_classes(tmp_path: Path) -> None:
    volume, loaded = TsdfVolume(CONFIG), TsdfVolume(CONFIG)
    for T in poses():
        look(volume, T)
    volume.save(tmp_path / "volume.npz")
    with np.load(tmp_path / "volume.npz") as arrays:
        older = {name: arrays[name] for name in arrays if not name.startswith("cell_")}
    np.savez(tmp_path / "older.npz", **older)
    loaded.load(tmp_path / "older.npz")
    top, _ = loaded.classes_at(on_rock(0.3))
    assert (top == ROCK).all()


def test_dropped_blocks_lose_their_classes() -> None:
    volume = TsdfVolume(TsdfConfig(semantic=True, max_blocks=120, when_full="drop"))
    look(volume, poses()[0])
    for x_m in (20.0, 40.0):
        T = camera_at((x_m, 0, 4), (x_m, 0.01, 0))
        volume.integrate(
            plane_depth_m(T, UP, 0.0), None, CAMERA, T, np.full((240, 320), 7, np.uint16)
        )
    ids, _ = volume.classes_at(on_rock(0.0))
    assert (ids == 0).all()
    look(volume, poses()[0], rock=3)
    ids, _ = volume.classes_at(on_rock(0.3))
    assert (ids == 3).all()


def test_label_cells_respect_the_memory_limit(tmp_path: Path) -> None:
    config = TsdfConfig(semantic=True, max_blocks=150, when_full="store", store_folder=tmp_path)
    volume = TsdfVolume(config)
    labels = np.ones((240, 320), np.uint16)
    for x_m in np.arange(0, 30, 3.0):
        T = camera_at((x_m, 0, 4), (x_m, 0.01, 0))
        volume.integrate(plane_depth_m(T, UP, 0.0), None, CAMERA, T, labels)
    assert volume.blocks_stored > 0
    assert 0 < volume.cell_blocks_in_memory <= CELL_BLOCKS_PER_BLOCK * volume.blocks_in_memory
    line_m = np.column_stack((np.arange(0, 27, 0.07), np.zeros(386), np.zeros(386)))
    ids, _ = volume.classes_at(line_m)
    assert (ids == 1).all()


@pytest.mark.parametrize("spread", [3, 60_000])
def test_unique_blocks_agree_with_numpy(spread: int) -> None:
    """Against numpy's sorting."""
    blocks = np.random.default_rng(1).integers(-spread, spread, (3, 500)).astype(np.int32)
    expected, place = np.unique(blocks.T, axis=0, return_inverse=True)
    found, number = unique_blocks(blocks)
    assert np.array_equal(found, expected)
    assert np.array_equal(number, place.ravel())


def test_pixels_wider_than_cells_fall_back_to_voxel_classes() -> None:
    """Voting pixels lie sqrt(2) pixels apart, cells half a voxel."""
    pixel_m = CONFIG.voxel_size_m / 2 / np.sqrt(2)
    for share, has_cells in ((0.9, True), (1.1, False)):
        height_m = share * pixel_m * CAMERA.fx_px
        volume, T = TsdfVolume(CONFIG), camera_at((0, 0, height_m), (0, 0.01, 0))
        look(volume, T)
        assert (volume.cell_blocks_in_memory > 0) == has_cells
        top, _ = volume.classes_at(on_rock(0.3))
        assert (top == ROCK).mean() > 0.95
