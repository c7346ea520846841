"""Reconstructed planes and spheres against their closed forms."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_views import (
    CAMERA,
    camera_at,
    plane_depth_m,
    sphere_depth_m,
)

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume, VolumeFullError
from oaisys_mapping.voxels import blocks


@pytest.mark.parametrize("tilt_deg", [0.0, -30.0, 30.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilted_plane_is_reconstructed_in_place(tilt_deg: float, axis: int) -> None:
    normal = np.array([0.0, 0.0, np.cos(np.radians(tilt_deg))])
    normal[axis] = np.sin(np.radians(tilt_deg))
    T = camera_at((0.01, 0, 8), (0, 0, 0))
    volume = TsdfVolume()
    volume.integrate(plane_depth_m(T, normal, 0.037), None, CAMERA, T)
    error_m = volume.extract_mesh().vertices_m @ normal - 0.037
    # The pixel nearest to a voxel is off by up to half a pixel, evenly in both directions: a
    # systematic half pixel would show as a mean of 8.5 mm at this tilt.
    assert abs(error_m.mean()) < 1e-3
    assert np.abs(error_m).max() < 0.03


def test_a_sphere_is_reconstructed_with_its_radius() -> None:
    volume = TsdfVolume(TsdfConfig(voxel_size_m=0.05))
    for azimuth_rad in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        eye_m = (5 * np.cos(azimuth_rad), 5 * np.sin(azimuth_rad), 2.0)
        T = camera_at(eye_m, (0, 0, 0))
        volume.integrate(sphere_depth_m(T, 1.5), None, CAMERA, T)
    radius_m = np.linalg.norm(volume.extract_mesh().vertices_m, axis=1)
    assert radius_m.mean() == pytest.approx(1.5, abs=0.005)
    assert radius_m.std() < 0.015


def test_colour_is_kept() -> None:
    T = camera_at((0.01, 0, 6), (0, 0, 0))
    rgb = np.full((240, 320, 3), (200, 100, 50), np.uint8)
    volume = TsdfVolume()
    volume.integrate(plane_depth_m(T, np.array([0, 0, 1.0]), 0), rgb, CAMERA, T)
    assert np.abs(volume.extract_mesh().colors_rgb.astype(int) - (200, 100, 50)).max() <= 1


def test_equal_views_give_equal_bytes() -> None:
    def build() -> tuple[bytes, bytes, bytes]:
        volume = TsdfVolume()
        for x in (-1.0, 0.0, 1.0):
            T = camera_at((x, 0.5, 7), (x + 0.2, 0, 0))
            volume.integrate(plane_depth_m(T, np.array([0.1, 0, 0.995]), 0), None, CAMERA, T)
        mesh = volume.extract_mesh()
        return mesh.vertices_m.tobytes(), mesh.triangles.tobytes(), mesh.colors_rgb.tobytes()

    assert build() == build()


def test_pixels_without_a_hit_or_beyond_the_range_are_not_mapped() -> None:
    T = camera_at((0.01, 0, 6), (0, 0, 0))
    volume = TsdfVolume(TsdfConfig(max_range_m=5.0))
    volume.integrate(np.full((240, 320), np.inf, np.float32), None, CAMERA, T)
    volume.integrate(plane_depth_m(T, np.array([0, 0, 1.0]), 0), None, CAMERA, T)
    assert volume.is_empty
    assert volume.frames == 2
    assert len(volume.extract_mesh().triangles) == 0


def test_reset_empties_a_volume_and_load_restores_it(tmp_path: Path) -> None:
    T = camera_at((0.01, 0, 6), (0, 0, 0))
    volume = TsdfVolume()
    volume.integrate(plane_depth_m(T, np.array([0, 0, 1.0]), 0), None, CAMERA, T)
    before = volume.extract_mesh()
    volume.save(tmp_path / "volume.npz")
    volume.reset()
    assert volume.is_empty
    volume.load(tmp_path / "volume.npz")
    assert np.array_equal(volume.extract_mesh().vertices_m, before.vertices_m)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("depth_m", {"depth_m": np.zeros((5, 5), np.float32)}),
        ("rgb", {"rgb": np.zeros((240, 320), np.uint8)}),
        ("T_map_camera", {"T_map_camera": np.full((4, 4), np.nan)}),
    ],
)
def test_images_of_the_wrong_size_and_invalid_poses_are_refused(
    field: str, change: dict[str, object]
) -> None:
    arguments: dict[str, object] = {
        "depth_m": np.ones((240, 320), np.float32),
        "rgb": None,
        "intrinsics": CAMERA,
        "T_map_camera": np.eye(4),
    }
    volume = TsdfVolume()
    with pytest.raises(InvalidInputError) as caught:
        volume.integrate(**{**arguments, **change})  # type: ignore[arg-type]
    assert caught.value.field == field
    assert volume.frames == 0


@pytest.mark.parametrize("name", ["voxel_size_m", "truncation_voxels", "max_range_m"])
def test_sizes_must_be_above_zero(name: str) -> None:
    zero: dict[str, Any] = {name: 0}
    with pytest.raises(InvalidInputError, match=name):
        TsdfConfig(**zero)


def fused(volume: TsdfVolume) -> TsdfVolume:
    for x in (-1.0, 0.0, 1.0):
        T = camera_at((x, 0.5, 7), (x + 0.2, 0, 0))
        volume.integrate(plane_depth_m(T, np.array([0.1, 0, 0.995]), 0), None, CAMERA, T)
    return volume


def test_growing_the_grid_does_not_change_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    reserved = fused(TsdfVolume()).extract_mesh()
    monkeypatch.setattr(blocks, "INITIAL_BLOCKS", 2)
    grown = fused(TsdfVolume()).extract_mesh()
    assert grown.vertices_m.tobytes() == reserved.vertices_m.tobytes()
    assert grown.triangles.tobytes() == reserved.triangles.tobytes()


def test_a_full_volume_raises_and_is_unchanged() -> None:
    volume = TsdfVolume(TsdfConfig(max_blocks=400))
    T = camera_at((0.01, 0, 6), (0, 0, 0))
    volume.integrate(plane_depth_m(T, np.array([0, 0, 1.0]), 0), None, CAMERA, T)
    before = volume.extract_mesh()
    far = camera_at((0.01, 0, 40), (0, 0, 0))
    with pytest.raises(VolumeFullError, match="400 may be used"):
        volume.integrate(plane_depth_m(far, np.array([0, 0, 1.0]), 0), None, CAMERA, far)
    assert volume.frames == 1
    assert np.array_equal(volume.extract_mesh().vertices_m, before.vertices_m)


def test_views_with_single_valid_pixels_are_accepted() -> None:
    """Open3D searches every fourth pixel for a surface, and raises if that finds nothing."""
    T = camera_at((0.01, 0, 6), (0, 0, 0))
    volume = TsdfVolume()
    for place in (101, 100):
        depth_m = np.full((240, 320), np.inf, np.float32)
        depth_m[place, place] = 5.0
        volume.integrate(depth_m, None, CAMERA, T)
    assert volume.frames == 2


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        (
            "tsdf",
            lambda values: np.full_like(values, np.nan),
            "tsdf has values that are not finite",
        ),
        ("weight", lambda values: values + np.inf, "weight has values that are not finite"),
        ("blocks", lambda values: values * 0, "blocks has a block twice"),
        ("blocks", lambda values: np.full_like(values, 2**31 - 1), r"blocks has \[2147483647, "),
        ("blocks", lambda values: np.full_like(values, -(2**31)), r"blocks has \[-2147483648, "),
        ("free", lambda values: values.astype(np.float64), r"free is float64 .* expected int32"),
        ("frames", lambda _: np.array(-5), "frames is -5"),
        ("voxel_size_m", lambda _: np.array(np.nan), "voxel_size_m is nan"),
        ("truncation_m", lambda _: np.array([1.0, 2.0]), "a saved volume"),
        ("blocks", lambda _: None, "a saved volume with 'blocks'"),
    ],
)
def test_damaged_volumes_are_refused_by_what_is_wrong(
    tmp_path: Path, name: str, change: Callable[[Any], Any], reason: str
) -> None:
    path = tmp_path / "volume.npz"
    fused(TsdfVolume()).save(path)
    arrays = dict(np.load(path))
    arrays[name] = change(arrays[name])
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    with pytest.raises(InvalidInputError, match=rf"volume\.npz.*{reason}"):
        TsdfVolume().load(path)


def test_files_of_other_volumes_and_formats_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "volume.npz"
    with pytest.raises(InvalidInputError, match="a saved volume"):
        TsdfVolume().load(path)
    path.write_bytes(b"not a volume")
    with pytest.raises(InvalidInputError, match="a saved volume"):
        TsdfVolume().load(path)
    fused(TsdfVolume(TsdfConfig(voxel_size_m=0.2))).save(path)
    with pytest.raises(InvalidInputError, match=r"0\.1 m"):
        TsdfVolume().load(path)
