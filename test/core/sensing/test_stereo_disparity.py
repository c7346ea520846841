"""OpenCV's stereo matcher finds, in rendered pictures, the disparities that the simulator gives."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray

SIZE_PX = (320, 240)
DISPARITIES_PX = 64
"""Range that the matcher searches."""

CONFIG = {
    "seed": 5,
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 32.0, "resolution_px": 257},
    "materials": {"texture_size_px": 512, "mask": {"size_px": 256}},
    "assets": {"rocks": [{"kind": "angular", "count": [60, 60]}]},
    "render": {"quality": "standard"},
    "sensors": {
        "stereo": [
            {
                "width_px": SIZE_PX[0],
                "height_px": SIZE_PX[1],
                "fx_px": 270.0,
                "fy_px": 270.0,
                "baseline_m": 0.25,
                "mount_quat_xyzw": [0.0, 0.34202014, 0.0, 0.93969262],
                "modalities": ["rgb", "disparity"],
            }
        ],
        "motion": {"kind": "hover", "look": "forward", "height_above_ground_m": 2.5},
    },
}


def matched_px(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W) disparities by semi-global matching, NaN where it is not sure."""
    block = 5
    matcher = cv2.StereoSGBM_create(
        numDisparities=DISPARITIES_PX,
        blockSize=block,
        P1=8 * block**2,
        P2=32 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=50,
        speckleRange=2,
    )
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
    found = matcher.compute(*grey).astype(np.float32) / 16
    found[found < 0] = np.nan
    return np.asarray(found)


@pytest.mark.long
@pytest.mark.blender
def test_semi_global_matching_finds_the_disparities() -> None:
    (sample,) = in_blender("sensors.samples", CONFIG, 1)
    images = {(sensor, modality): data for sensor, modality, data in sample}
    found = matched_px(images["stereo_left", "rgb"], images["stereo_right", "rgb"])
    true = images["stereo_left", "disparity"]
    # A pixel at column u of the left image is at u - disparity of the right one.
    in_both = (np.arange(SIZE_PX[0]) >= true) & (true > 0) & (true < DISPARITIES_PX)
    judged = in_both & np.isfinite(found)
    error_px = np.abs(found - true)[judged]
    assert judged.sum() > 0.5 * in_both.sum()
    assert np.median(error_px) < 0.25
    assert np.mean(error_px < 1) > 0.9
