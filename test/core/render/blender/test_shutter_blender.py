"""Colour through rolling shutters and during exposures, against renders of cameras that stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from synthetic_worlds import CENTRED, SPHERE, camera, flat_world

from oaisys_core.geometry import pose_looking_at
from oaisys_core.scene import PlacedCamera, Scene
from oaisys_core.types import PinholeIntrinsics
from oaisys_core.world.modules.lidars import ConstantVelocity

pytestmark = pytest.mark.blender

SAMPLES = 64
STILLS = 13
"""Still cameras in an exposure."""
FISHEYE = PinholeIntrinsics(64, 48, 40.0, 40.0, 31.5, 23.5, (), "equidistant")
SHIFTED = replace(FISHEYE, cy_px=19.5)


def world() -> Scene:
    return replace(flat_world(), primitives=(SPHERE,))


def still(intrinsics: PinholeIntrinsics) -> PlacedCamera:
    return camera(pose_looking_at((-3.0, 0.0, 2.5), (2.0, 1.0, 1.0)), intrinsics, ("rgb",))


def moving(placed: PlacedCamera, readout_s: float, exposure_s: float) -> PlacedCamera:
    motion = ConstantVelocity(
        placed.T_map_camera, np.array((2.0, 12.0, 0.0)), np.array((0.5, 3.0, 2.0))
    )
    return replace(placed, pose_at=motion, readout_s=readout_s, exposure_s=exposure_s)


def rendered(*cameras: PlacedCamera) -> list[NDArray[np.float64]]:
    scene = world()
    seen = in_blender("sensors.views", [(scene, each) for each in cameras], SAMPLES)
    return [frames[0].data.astype(np.float64) for frames in seen]


def at_times(placed: PlacedCamera, times_s: NDArray[np.float64]) -> list[PlacedCamera]:
    assert placed.pose_at is not None
    return [
        replace(placed, T_map_camera=T, pose_at=None, readout_s=0.0, exposure_s=0.0)
        for T in placed.pose_at(times_s)
    ]


@pytest.mark.parametrize(
    "intrinsics",
    [
        pytest.param(CENTRED, id="pinhole", marks=pytest.mark.long),
        pytest.param(FISHEYE, id="fisheye", marks=pytest.mark.soak),
        pytest.param(SHIFTED, id="shifted", marks=pytest.mark.soak),
    ],
)
def test_each_row_shows_what_a_still_camera_sees_where_the_row_is_read(
    intrinsics: PinholeIntrinsics,
) -> None:
    rolling = moving(still(intrinsics), 0.04, 0.0)
    rows = np.arange(3, 48, 9)
    first, seen, *stills = rendered(
        still(intrinsics), rolling, *at_times(rolling, rows * 0.04 / 47)
    )
    errors = [
        np.abs(seen[row] - image[row]).mean() for row, image in zip(rows, stills, strict=True)
    ]
    unmoved = [np.abs(seen[row] - first[row]).mean() for row in rows]
    assert np.mean(errors) < 0.1
    assert np.mean(unmoved) > 3


@pytest.mark.parametrize(
    "readout_s",
    [
        pytest.param(0.0, id="global", marks=pytest.mark.long),
        pytest.param(0.03, id="rolling", marks=pytest.mark.soak),
    ],
)
def test_an_exposure_is_the_mean_of_what_still_cameras_see_during_it(readout_s: float) -> None:
    exposure_s = 0.1
    blurred = moving(still(CENTRED), readout_s, exposure_s)
    row = 30
    middle_s = row * readout_s / 47
    times_s = middle_s + exposure_s * ((np.arange(STILLS) + 0.5) / STILLS - 0.5)
    seen, *stills = rendered(blurred, *at_times(blurred, times_s))
    rows = slice(row, row + 1) if readout_s else slice(None)
    mean, middle = np.mean(stills, axis=0)[rows], stills[STILLS // 2][rows]
    error = np.abs(seen[rows] - mean).mean()
    assert error < 1.0
    assert error < 0.3 * np.abs(seen[rows] - middle).mean()
