"""Water, ice and mud are free of salt and pepper, though samples are reflected by chance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from speckle import NOISE, speckle_share

from oaisys_core.geometry import pose_looking_at

pytestmark = pytest.mark.blender

MAX_SHARE = {"preview": 0.02, "standard": 0.01, "final": 0.01}
"""Of the pixels, by quality. Of four seeds, `preview` has 0.7 to 1.5 % on ice at dusk."""

ABOVE, GRAZING = (
    pose_looking_at((-5.0, -4.0, 4.0), (0.0, 0.0, 0.0)),
    pose_looking_at((-12.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
)
SUNNY, DUSK = 30.0, -1.0
"""Elevations of the sun: at dusk, only the sky shines."""

LAYERS = {"pools": ("gravel", "sand"), "ice": ("ice", "mud"), "mud": ("mud", "gravel")}

LEVEL = pose_looking_at((0.0, 0.0, 2.5), (10.0, 0.0, 3.0))

BRIGHTER = 45
"""Sum of three bytes by which reflections may be brighter than the sky above the horizon, because
an overcast sky is brighter farther up. Silhouettes were brighter by 73 to 101."""


def world(kind: str) -> dict[str, Any]:
    stage: dict[str, Any] = {
        "preset": "mounds", "extent_m": 32.0, "resolution_px": 193, "relief_m": 0.6
    }  # fmt: skip
    if kind == "pools":
        stage["water"] = {"level_share": 0.62, "clarity_m": 1.5, "semantic_id": 40}
    layers = [
        {"texture": texture, "label": texture, "semantic_id": 1 + index}
        for index, texture in enumerate(LAYERS[kind])
    ]
    return {
        "seed": 2,
        "stage": stage,
        "materials": {"layers": layers},
        "assets": {"rocks": []},
        "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "modalities": ["rgb"]}]},
    }


def test_the_measure_counts_noise_and_neither_stones_nor_edges() -> None:
    rng = np.random.default_rng(0)
    clean = np.full((48, 64, 3), 90, np.uint8)
    clean[:, 40:] = 160
    clean[rng.uniform(size=(48, 64)) < 0.05] = 200
    noisy = clean.copy()
    is_noise = rng.uniform(size=(48, 64)) < 0.04
    noisy[is_noise] += np.uint8(4 * NOISE)

    assert speckle_share(clean, clean) == 0
    assert speckle_share(np.roll(clean, 1, axis=1), clean) < 0.01
    assert speckle_share(noisy, clean) == pytest.approx(0.03, abs=0.015)


@pytest.mark.parametrize(
    ("kind", "suns"),
    [
        pytest.param("pools", (DUSK,), marks=pytest.mark.long),
        pytest.param("pools", (SUNNY,), marks=pytest.mark.soak),
        pytest.param("ice", (DUSK,), marks=pytest.mark.long),
        pytest.param("ice", (SUNNY,), marks=pytest.mark.soak),
    ],
)
def test_what_reflects_by_chance_is_as_smooth_as_with_many_samples(
    kind: str, suns: tuple[float, ...]
) -> None:
    qualities = tuple(MAX_SHARE)
    found = in_blender("water.pictures", world(kind), [ABOVE, GRAZING], suns, qualities)
    shares = {
        each: speckle_share(picture, found[*each[:2], "final"]) for each, picture in found.items()
    }
    assert all(share < MAX_SHARE[each[2]] for each, share in shares.items()), shares
    assert len(shares) == 2 * len(suns) * len(qualities)


def test_a_film_before_the_sky_has_no_bright_outline() -> None:
    overcast = {**world("mud"), "environment": {"sky": {"model": "overcast"}}}
    found = in_blender("water.pictures", overcast, [LEVEL], (40.0,), ("preview",))
    (picture,) = found.values()
    light = picture.astype(int).sum(axis=-1)
    assert light[40:].mean() < 0.8 * light[:8].mean(), "ground below the sky"
    assert light.max() < np.median(light[:8]) + BRIGHTER
