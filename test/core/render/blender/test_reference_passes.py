"""Depth and labels of samples against Cycles' own passes, on every preset of terrain."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.types import DEPTH, INSTANCE, SEMANTIC_0

pytestmark = pytest.mark.blender

SEMANTIC_1 = "semantic_1"

MODALITIES = (DEPTH, SEMANTIC_0, SEMANTIC_1, INSTANCE)

WIDTH_PX, HEIGHT_PX = 128, 96

JITTER_PX = 0.006
"""Greatest distance of Cycles' rays from their pixels' centres, and a bit."""

MAX_JITTER_M = 0.01
"""Way of such a ray along the ground up to which labels must be the same."""

DEPTH_TOLERANCE = 2e-5
"""Relative, beside what the jitter does."""

DRY = {"label": "dry", "semantic_id": 101}

CONFIG: dict[str, Any] = {
    "seed": 5,
    "stage": {"extent_m": 32.0, "resolution_px": 129},
    "materials": {
        "layers": [
            {"texture": "gravel", "label": "gravel", "semantic_id": 1},
            {"texture": "sand", "label": "sand", "semantic_id": 2, "levels": [DRY]},
        ],
        "mask": {"scale_m": 5.0},
        "texture_size_px": 64,
    },
    "assets": {
        "rocks": [
            {"kind": "boulder", "count": [20, 20], "size_m": [0.5, 1.5], "variants": 2},
            {"kind": "rounded", "count": [300, 300], "size_m": [0.2, 0.6], "variants": 1},
        ],
    },
    "sensors": {
        "cameras": [
            {
                "name": "camera",
                "width_px": WIDTH_PX,
                "height_px": HEIGHT_PX,
                "fx_px": 100.0,
                "fy_px": 105.0,
                "cx_px": 60.0,
                "cy_px": 50.0,
                "modalities": list(MODALITIES),
            }
        ],
        "pose_policy": "allow",
    },
}

Images = dict[str, NDArray[Any]]


@cache
def views(preset: str) -> list[tuple[Images, Images]]:
    """Of a preset: images as samples give them, and as Cycles does."""
    return list(in_blender("reference.both_ways", CONFIG, preset, MODALITIES))


SEEN = {"river_bed"}
"""Presets of test-full, with water and banks; the others differ in the heights of the same grid."""


@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(preset, marks=pytest.mark.long if preset in SEEN else pytest.mark.soak)
        for preset in sorted(PRESETS)
    ],
)
def test_samples_show_what_cycles_sees(preset: str) -> None:
    pixels = differing = 0
    for fast, cycles in views(preset):
        depth_m = fast[DEPTH]
        reached = np.where(np.isfinite(depth_m), depth_m, 1e6)
        error_m = np.abs(np.where(np.isfinite(cycles[DEPTH]), cycles[DEPTH], 1e6) - reached)
        is_off = error_m > DEPTH_TOLERANCE * reached + JITTER_PX * spread(reached)
        # Far away, on ground seen edge-on, the jitter goes from one patch of a layer to the next.
        jitters = (JITTER_PX * spread(reached) > MAX_JITTER_M) & (fast[INSTANCE] == 0)
        for modality in MODALITIES[1:]:
            is_off |= (fast[modality] != cycles[modality]) & ~(jitters & (modality != INSTANCE))
        assert not is_off[off_edges(fast)].any()
        pixels, differing = pixels + is_off.size, differing + is_off.sum()
    assert differing <= 5e-4 * pixels


@pytest.mark.long
def test_views_show_something_of_everything() -> None:
    ids = set()
    for preset in sorted(SEEN):
        fast = [images for images, _ in views(preset)]
        assert sum(off_edges(images).mean() for images in fast) > 1.0
        assert len(np.unique(np.stack([images[INSTANCE] for images in fast]))) > 25
        ids |= set(np.unique(np.stack([images[SEMANTIC_0] for images in fast])).tolist())
    assert {0, 1, 2, 10} <= ids


def off_edges(images: Images) -> NDArray[np.bool_]:
    """Pixels whose neighbours are of the same thing and label, on a surface without steps."""
    depth_m = np.where(np.isfinite(images[DEPTH]), images[DEPTH], 1e6)
    inside = np.ones(depth_m.shape, bool)
    for modality in MODALITIES:
        ids = images[modality].astype(np.float32) if modality != DEPTH else np.isinf(depth_m)
        ids = np.asarray(ids, np.float32)
        inside &= spread(ids) == 0
    return inside & (spread(depth_m) < 0.1 * depth_m)


def spread(image: NDArray[Any]) -> NDArray[Any]:
    """Range (greatest minus least value) of each pixel and its eight neighbours."""
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(image, square) - cv2.erode(image, square))
