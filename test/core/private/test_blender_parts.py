"""Renders with private parts of Blender taken away: the same images, and a line in the log."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from blender_process import in_new_blender

pytestmark = [pytest.mark.blender, pytest.mark.long]

LEAST_PSNR_DB = 25.0
"""Between pictures that were denoised in different ways."""


@pytest.fixture(scope="module")
def outcomes() -> dict[str, Any]:
    found: dict[str, Any] = in_new_blender("private_parts.outcomes")
    return found


def assert_said_once(outcome: Any, part: str) -> None:
    assert [part in warning for warning in outcome.warnings] == [True], outcome.warnings


def assert_same_images(outcome: Any, control: Any) -> None:
    for images, expected in zip(outcome.images, control.images, strict=True):
        for modality, image in expected.items():
            np.testing.assert_array_equal(images[modality], image, modality)


def test_with_all_parts_nothing_is_said(outcomes: dict[str, Any]) -> None:
    assert outcomes["all"].warnings == []


def test_without_embree_open3d_sees_the_same(outcomes: dict[str, Any]) -> None:
    assert_said_once(outcomes["embree"], "Blender's Embree cannot be used")
    for images, expected in zip(outcomes["embree"].images, outcomes["all"].images, strict=True):
        for modality, image in expected.items():
            if modality == "depth":
                np.testing.assert_allclose(images[modality], image, rtol=1e-6)
            else:
                np.testing.assert_array_equal(images[modality], image, modality)


def test_without_open_image_denoise_cycles_denoises(outcomes: dict[str, Any]) -> None:
    outcome = outcomes["open_image_denoise"]
    assert_said_once(outcome, "Blender's Open Image Denoise cannot be used")
    for images, expected in zip(outcome.images, outcomes["all"].images, strict=True):
        assert LEAST_PSNR_DB < cv2.PSNR(images["rgb"], expected["rgb"]) < 100


def test_without_the_add_ons_methods_passes_come_from_a_file(outcomes: dict[str, Any]) -> None:
    assert_said_once(outcomes["cycles_addon"], "The Cycles add-on cannot be used")
    assert_same_images(outcomes["cycles_addon"], outcomes["all"])


def test_without_the_c_library_s_stream_blender_prints(outcomes: dict[str, Any]) -> None:
    assert_said_once(outcomes["c_output"], "The C library's stream of output cannot be used")
    assert_same_images(outcomes["c_output"], outcomes["all"])


def test_without_cycles_own_end_a_render_goes_on_and_is_cancelled_then(
    outcomes: dict[str, Any],
) -> None:
    outcome = outcomes["cycles_session"]
    assert_said_once(outcome, "Cycles' function that ends a render cannot be used")
    assert outcome.told is True
    assert_same_images(outcome, outcomes["all"])


def test_without_cycles_log_black_ground_is_found(outcomes: dict[str, Any]) -> None:
    outcome = outcomes["cycles_log"]
    assert_said_once(outcome, "Cycles' log cannot be used")
    assert outcome.told["object"] == ""
    before, failed, after = outcome.told["ground"]
    assert "100% of the ground of the stage is black" in failed
    assert (before, after) == ("", "")
    assert_same_images(outcome, outcomes["all"])
