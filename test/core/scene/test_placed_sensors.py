"""A camera is sharp where neither its lens nor its own motion blurs colours."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from oaisys_core.scene import Lens, PlacedCamera
from oaisys_core.types import RGB, FloatArray, PinholeIntrinsics

LENS = PinholeIntrinsics(4, 3, 4.0, 4.0, 1.5, 1.0)
STILL = PlacedCamera("camera", LENS, np.eye(4), (RGB,))


def poses(speed_m_s: float, times_s: FloatArray) -> FloatArray:
    """Return (N, 4, 4) poses of a camera that moves along x."""
    moved = np.tile(np.eye(4), (len(times_s), 1, 1))
    moved[:, 0, 3] = speed_m_s * times_s
    return moved


@pytest.mark.parametrize(
    ("placed", "is_sharp"),
    [
        (STILL, True),
        (replace(STILL, lens=Lens(2.0, 4.0)), False),
        (replace(STILL, exposure_s=0.01), True),
        (replace(STILL, exposure_s=0.01, pose_at=partial(poses, 0.0)), True),
        (replace(STILL, exposure_s=0.01, pose_at=partial(poses, 1.0)), False),
        (replace(STILL, readout_s=0.01, pose_at=partial(poses, 1.0)), True),
        (replace(STILL, shutter_share=0.5), True),
        (replace(STILL, shutter_share=0.5, T_map_previous=np.eye(4)), True),
        (replace(STILL, shutter_share=0.5, T_map_previous=poses(1.0, np.ones(1))[0]), False),
    ],
)
def test_only_motion_while_the_shutter_is_open_blurs(placed: PlacedCamera, is_sharp: bool) -> None:
    assert placed.is_sharp is is_sharp
