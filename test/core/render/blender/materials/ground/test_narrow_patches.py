"""Albedo is shared where rows of pixels are farther apart than patches of ground are wide."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.render.blender.materials.ground.narrow_patches import Patches, share_albedo
from oaisys_core.scene import PbrMaps, TerrainLayer, TerrainMaterial

pytestmark = pytest.mark.blender

ROWS, COLUMNS = 60, 400
FOCAL_PX, HEIGHT_M = 100.0, 2.0
PATCH_M = 1.0
PATCHES = Patches(PATCH_M, pixel_rad=0.0)

# A plane's depth changes by z^2 / (f h) from one row to the next.
FAR_ROW = int(FOCAL_PX * HEIGHT_M / np.sqrt(1.5 * PATCH_M * FOCAL_PX * HEIGHT_M)) - 2
NEAR_ROW = int(FOCAL_PX * HEIGHT_M / np.sqrt(0.5 * PATCH_M * FOCAL_PX * HEIGHT_M)) + 2


def plane() -> NDArray[np.float32]:
    """Depth of a plane below a level camera, from the horizon down."""
    depth_m = FOCAL_PX * HEIGHT_M / (np.arange(ROWS) + 1.0)
    return np.repeat(depth_m[:, None], COLUMNS, axis=1).astype(np.float32)


def grains() -> NDArray[np.float32]:
    rng = np.random.default_rng(1)
    return np.where(rng.uniform(size=(ROWS, COLUMNS, 1)) < 0.5, 0.1, 0.8).astype(np.float32)


@pytest.mark.parametrize(("samples", "own"), [(1, 0.3), (3, 0.5)])
def test_far_away_neighbours_share_what_they_see(samples: int, own: float) -> None:
    albedo, depth_m = grains().repeat(3, axis=2), plane()
    is_ground = np.ones(depth_m.shape, bool)

    found, share = share_albedo(albedo, depth_m, is_ground, PATCHES, samples)

    assert (found[NEAR_ROW:] == albedo[NEAR_ROW:]).all(), "nothing near gets blurred"
    assert (share[NEAR_ROW:] == 0).all()
    far = slice(2, FAR_ROW - 2)
    assert (share[far] == 1).all()
    assert found[far].mean() == pytest.approx(albedo[far].mean(), abs=0.01)
    # Sums of squares of weights, of 5 columns of 0.2 each and rows of 0.2, 0.6 and 0.2.
    variance = own**2 + 2 * own * (1 - own) * 0.12 + (1 - own) ** 2 * 0.2 * 0.44
    assert found[far].var() / albedo[far].var() == pytest.approx(variance, rel=0.1)


def test_a_camera_on_its_side_shares_along_the_other_axis() -> None:
    albedo, depth_m = grains().repeat(3, axis=2), plane()
    is_ground = np.ones(depth_m.shape, bool)
    upright, _ = share_albedo(albedo, depth_m, is_ground, PATCHES, 1)
    turned, _ = share_albedo(albedo.swapaxes(0, 1), depth_m.T, is_ground.T, PATCHES, 1)
    np.testing.assert_allclose(turned.swapaxes(0, 1), upright, atol=1e-6)


def test_things_and_their_edges_share_nothing() -> None:
    albedo, depth_m = grains().repeat(3, axis=2), plane()
    is_ground = np.ones(depth_m.shape, bool)
    depth_m[:, 100:200], is_ground[:, 100:200] = 3.0, False

    found, share = share_albedo(albedo, depth_m, is_ground, PATCHES, 1)

    assert (found[:, 100:200] == albedo[:, 100:200]).all()
    assert (share[NEAR_ROW:] == 0).all(), "a step of depth beside a thing is no slant"
    albedo[:, 100:200] = np.nan
    finite, _ = share_albedo(np.nan_to_num(albedo), depth_m, is_ground, PATCHES, 1)
    assert (finite[:, 200:] == found[:, 200:]).all(), "nor does ground take anything of things"


def test_pixels_as_wide_as_patches_share_with_all_around_them() -> None:
    albedo = grains().repeat(3, axis=2)
    depth_m = np.full((ROWS, COLUMNS), 20.0, np.float32)
    is_ground = np.ones(depth_m.shape, bool)

    narrow, share = share_albedo(albedo, depth_m, is_ground, Patches(PATCH_M, 0.25 / 20), 1)
    assert (narrow == albedo).all(), "a quarter of a patch is seen as it is"
    assert (share == 0).all()

    wide, share = share_albedo(albedo, depth_m, is_ground, Patches(PATCH_M, 0.75 / 20), 1)
    assert (share == 1).all()
    assert wide.mean() == pytest.approx(albedo.mean(), abs=0.01)
    # 0.7 of the mean with each axis' neighbours: the product of two independent smoothings.
    assert wide.var() < 0.15 * albedo.var()


def test_patches_are_as_wide_as_their_stripes() -> None:
    maps = PbrMaps(
        "flat", np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32),
        np.full((1, 1, 3), 128, np.uint8), np.zeros((1, 1), np.uint8), 1.0,
    )  # fmt: skip
    layers = tuple(TerrainLayer(name, (1,), maps) for name in "ab")
    checks = (np.indices((128, 128)) // 8).sum(axis=0) % 2
    masks = np.stack((checks, 1 - checks)).astype(np.float32)
    material = TerrainMaterial(layers, masks, (-32.0, -32.0, 32.0, 32.0))
    # 15 changes in 64 m.
    assert material.patch_m == pytest.approx(64 / 15)
    one = TerrainMaterial(layers[:1], masks[:1] * 0 + 1, material.extent_m)
    assert one.patch_m == np.inf
