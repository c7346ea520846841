"""Colour on a GPU beside colour on the CPU, within the tolerance of docs/performance.md."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from blender_process import in_new_blender
from numpy.typing import NDArray

pytestmark = [pytest.mark.blender, pytest.mark.long]

MIN_PSNR_DB = 41.0
"""Between devices, at 64 samples per pixel without a denoiser."""
MEAN_LEVELS = 0.5
"""Difference of a channel's mean, of 255 levels."""
DENOISED_LOSS_DB = 2.0
"""By which a GPU's denoised picture may be farther from a converged one than the CPU's."""


@pytest.fixture(scope="module")
def pictures() -> dict[str, Any]:
    found: dict[str, Any] = in_new_blender("devices.pictures")
    return found


def mean_difference(one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(np.abs(one.mean((0, 1)) - other.mean((0, 1))).max())


def agree(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return cv2.PSNR(one, other) >= MIN_PSNR_DB and mean_difference(one, other) <= MEAN_LEVELS


def test_the_tolerance_allows_other_noise_and_no_other_exposure(pictures: dict[str, Any]) -> None:
    assert agree(pictures["another seed"], pictures["cpu"])
    assert not agree(pictures["brighter"], pictures["cpu"])


def test_a_gpu_shows_what_the_cpu_shows(pictures: dict[str, Any]) -> None:
    if pictures["device"] == "cpu":
        assert agree(pictures["auto"], pictures["cpu"])
        pytest.skip("Cycles finds no GPU on this machine (render.device: auto chose the CPU)")
    assert agree(pictures["auto"], pictures["cpu"])
    truth = pictures["converged"]
    loss_db = cv2.PSNR(pictures["cpu denoised"], truth) - cv2.PSNR(pictures["auto denoised"], truth)
    assert loss_db <= DENOISED_LOSS_DB
