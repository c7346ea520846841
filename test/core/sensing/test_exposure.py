"""Automatic exposure: what it meters, and that a view alone decides about it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, RenderError
from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.sensing.exposure import AutoExposure, meter_ev
from oaisys_core.simulation import Simulation
from oaisys_core.types import RGB, ModuleMetadata, Sample

SIZE_PX = (48, 64)
GROUND = np.indices(SIZE_PX)[0] >= SIZE_PX[0] // 2
"""Pixels of the ground: the lower half."""
METER = AutoExposure(target=0.18)
SIMPLE: dict[str, Any] = {
    "seed": 3,
    "backend": "analytic",
    "stage": {"preset": "mounds", "extent_m": 24.0, "resolution_px": 33, "surroundings": "plain"},
    "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
    "assets": {"rocks": []},
    "sensors": {"cameras": [{"width_px": 32, "height_px": 24, "modalities": ["rgb", "depth"]}]},
}
DOWN, LEVEL = pose_looking_down(0, 0, 9), pose_looking_at((-9, 0, 4), (9, 0, 3))


def picture(ground: float, sky: float) -> NDArray[np.float32]:
    """A grey picture of ground below and sky above."""
    grey = np.where(GROUND, ground, sky)[..., None]
    return np.asarray(np.repeat(grey, 3, axis=2), np.float32)


def test_the_mean_of_the_ground_becomes_the_target() -> None:
    assert meter_ev(picture(0.09, 0.09), GROUND, METER) == pytest.approx(1.0, abs=1e-3)
    assert meter_ev(picture(0.36, 0.36), GROUND, METER) == pytest.approx(-1.0, abs=1e-3)
    compensated = AutoExposure(target=0.18, compensation_ev=0.5)
    assert meter_ev(picture(0.09, 0.09), GROUND, compensated) == pytest.approx(1.5, abs=1e-3)
    assert meter_ev(picture(0.09, 0.09), GROUND, METER, base_ev=0.6) == pytest.approx(0.4)


def test_neither_a_black_nor_a_bright_sky_decides_about_the_ground() -> None:
    even = meter_ev(picture(0.09, 0.09), GROUND, METER)
    for sky in (0.0, 0.25):
        assert abs(meter_ev(picture(0.09, sky), GROUND, METER) - even) < 0.1


@pytest.mark.parametrize("lit_rows", [2, 4, 12, 20])
def test_the_part_of_the_moon_that_a_low_sun_lights_is_not_white(lit_rows: int) -> None:
    shade = picture(1e-4, 0.0)
    shade[-lit_rows:] = 0.3
    exposed = 0.3 * 2.0 ** meter_ev(shade, GROUND, METER, white=16.0)
    assert 0.9 * METER.target < exposed < 4 * METER.target


def test_shade_under_a_sky_counts_as_lit_ground() -> None:
    shade = picture(0.02, 0.3)
    shade[-12:] = 0.3
    exposed = 0.16 * 2.0 ** meter_ev(shade, GROUND, METER, white=16.0)
    assert exposed == pytest.approx(METER.target, rel=0.05)


def test_a_lamps_light_on_dark_ground_is_not_white() -> None:
    night = picture(1e-4, 0.0)
    night[30:36, 20:40] = 0.02
    exposed = 0.02 * 2.0 ** meter_ev(night, GROUND, METER, white=4.0)
    assert 0.3 < exposed < 4.0


def test_a_bright_sky_darkens_the_picture_until_it_is_white_or_by_one_stop() -> None:
    even = meter_ev(picture(0.09, 0.09), GROUND, METER)
    white = 2.0 ** meter_ev(picture(0.09, 0.8), GROUND, METER) * 0.8
    assert white == pytest.approx(1.0, rel=1e-3)
    assert even - meter_ev(picture(0.09, 50.0), GROUND, METER) == pytest.approx(1.0, abs=0.3)
    brighter_white = meter_ev(picture(0.09, 0.8), GROUND, METER, white=4.0)
    assert brighter_white == pytest.approx(even, abs=0.3)


def test_bright_ground_darkens_the_picture_by_two_stops() -> None:
    spot = picture(0.09, 0.09)
    spot[40:48, 8:24] = 1.4
    mean = (0.09 * (24 * 64 - 128) + 1.4 * 128) / (24 * 64)
    by_mean_ev = np.log2(METER.target / mean)
    white = replace(METER, bright_share=0.5)
    # Metered by its mean alone, half of the picture may be bright; else 1.4 would be white.
    assert meter_ev(spot, GROUND, white) == pytest.approx(by_mean_ev, abs=0.1)
    assert meter_ev(spot, GROUND, METER) == pytest.approx(np.log2(1 / 1.4), abs=0.01)
    limited = meter_ev(spot, GROUND, white) - meter_ev(spot, GROUND, METER, white=0.1)
    assert limited == pytest.approx(2.0, abs=1e-3)


def test_the_sky_decides_where_there_is_nothing_else() -> None:
    nothing = np.zeros(SIZE_PX, np.bool_)
    assert meter_ev(picture(0.36, 0.36), nothing, METER) == pytest.approx(-1.0, abs=1e-3)


def test_the_limits_hold_and_black_is_exposed_most() -> None:
    assert meter_ev(picture(0.0, 0.0), GROUND, METER) == METER.max_ev
    assert meter_ev(picture(1e-7, 1e-7), GROUND, METER) == METER.max_ev
    assert meter_ev(picture(1e4, 1e4), GROUND, METER) == METER.min_ev


def test_noise_resolution_and_the_suns_disc_hardly_matter() -> None:
    rng = np.random.default_rng(5)
    even = meter_ev(picture(0.09, 0.05), GROUND, METER)
    noisy = picture(0.09, 0.05) * rng.gamma(4.0, 0.25, (*SIZE_PX, 1)).astype(np.float32)
    assert meter_ev(noisy, GROUND, METER) == pytest.approx(even, abs=0.05)
    with_sun = picture(0.09, 0.05)
    with_sun[5:7, 30:32] = 5e4
    assert meter_ev(with_sun, GROUND, METER) == pytest.approx(even, abs=0.25)
    half = np.ascontiguousarray(picture(0.09, 0.05)[::2, ::2])
    assert meter_ev(half, GROUND[::2, ::2], METER) == pytest.approx(even, abs=0.05)


def simulation(**sections: Any) -> Simulation:
    made = Simulation(config_from_mapping({**SIMPLE, **sections}), pose_cache_bytes=1 << 24)
    made.step_batch()
    return made


def sample(sim: Simulation, pose: Any, **parts: Any) -> Sample:
    return sim.step_sample(ModuleMetadata(sensor={"pose": pose}, **parts))


def exposure_ev(found: Sample) -> float:
    value = json.loads(found.provenance.exposures_json)["camera"]
    assert isinstance(value, float)
    return value


def rgb(found: Sample) -> NDArray[np.uint8]:
    return np.asarray(found.frame("camera", RGB).data)


def test_a_view_has_the_same_exposure_whatever_came_before() -> None:
    first = simulation()
    noon = sample(first, DOWN)
    dusk = sample(first, LEVEL, environment={"sun_elevation_deg": 2.0})
    again = sample(first, DOWN, environment={"sun_elevation_deg": 38.0})
    fresh = sample(simulation(), LEVEL, environment={"sun_elevation_deg": 2.0})
    assert exposure_ev(dusk) > exposure_ev(noon) + 1
    assert again.from_cache
    assert exposure_ev(again) == exposure_ev(noon)
    assert exposure_ev(fresh) == exposure_ev(dusk)
    assert (rgb(fresh) == rgb(dusk)).all()
    assert (rgb(again) == rgb(noon)).all()


def test_a_recorded_sample_is_repeated_with_its_exposure() -> None:
    sim = simulation()
    sample(sim, DOWN)
    outline = sample(sim, LEVEL)
    assert simulation().repeat(outline.outline).provenance == outline.provenance


def test_the_recorded_exposure_as_a_fixed_one_gives_the_same_picture() -> None:
    metered = sample(simulation(), LEVEL)
    fixed = sample(simulation(render={"exposure_ev": exposure_ev(metered)}), LEVEL)
    assert (rgb(fixed) == rgb(metered)).all()
    assert fixed.provenance.exposures_json == metered.provenance.exposures_json
    darker = sample(simulation(render={"exposure_ev": exposure_ev(metered) - 1}), LEVEL)
    assert rgb(darker).mean() < rgb(metered).mean() - 10
    depth = [each.frame("camera", "depth").data.tobytes() for each in (metered, fixed, darker)]
    assert depth[0] == depth[1] == depth[2]


def test_pictures_of_a_weaker_sun_are_as_bright_until_night() -> None:
    sim = simulation(environment={"sky": {"model": "none"}})
    noon = sample(sim, DOWN)
    weak = sample(sim, DOWN, environment={"sun_strength_w_m2": 1.0})
    assert exposure_ev(weak) - exposure_ev(noon) == pytest.approx(2.0, abs=2e-3)
    assert np.abs(rgb(weak).astype(int) - rgb(noon)).max() <= 1
    night = sample(sim, DOWN, environment={"sun_strength_w_m2": 1e-4})
    assert exposure_ev(night) == METER.max_ev
    assert rgb(night).mean() < rgb(noon).mean() / 3


def test_samples_without_colour_have_no_exposure() -> None:
    sim = simulation()
    found = sim.step_sample(ModuleMetadata(sensor={"pose": DOWN}), modalities=["depth"])
    assert found.provenance.exposures_json == ""


def test_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(ConfigError, match="auto_exposure"):
        simulation(render={"auto_exposure": {"min_ev": 2, "max_ev": 1}})


def grey_world(folder: Path, byte: int, albedo_share: float) -> Simulation:
    """A world whose ground has one colour everywhere."""
    folder.mkdir()
    color = np.full((8, 8, 3), byte, np.uint8)
    assert cv2.imwrite(str(folder / "ground_color.png"), color)
    layer = {"folder": str(folder), "label": "ground", "semantic_id": 1}
    variation = {"brightness": 0.0, "tint": 0.0}
    return simulation(
        materials={**SIMPLE["materials"], "layers": [layer], "variation": variation},
        render={"auto_exposure": {"albedo_share": albedo_share}},
        environment={"sky": {"model": "none"}},
    )


@pytest.mark.parametrize(("albedo_share", "shown"), [(1.0, 0.0), (0.5, 0.5), (0.0, 1.0)])
def test_dark_ground_is_dark_beside_bright_ground(
    albedo_share: float, shown: float, tmp_path: Path
) -> None:
    """With a share of 1, the same light has the same exposure, whatever it falls on."""
    dark, bright = 100, 160  # sRGB-encoded
    worlds = [grey_world(tmp_path / str(byte), byte, albedo_share) for byte in (dark, bright)]
    dark_ev, bright_ev = (exposure_ev(sample(world, DOWN)) for world in worlds)
    decoded = [((byte / 255 + 0.055) / 1.055) ** 2.4 for byte in (dark, bright)]
    stops = np.log2(decoded[1] / decoded[0])
    assert dark_ev - bright_ev == pytest.approx(shown * stops, abs=0.02)


def test_ground_of_usual_albedo_is_exposed_to_the_target_at_each_share() -> None:
    for share in (0.0, 0.5, 1.0):
        meter = AutoExposure(target=0.25, albedo_share=share)
        assert meter.for_ground(0.2).target == pytest.approx(0.25)
        assert 0 < meter.for_ground(0.0).target <= 0.25


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_radiance_that_is_not_finite_fails_the_render(value: float) -> None:
    radiance = picture(0.2, 1.0)
    radiance[40, :3] = value
    with pytest.raises(RenderError, match="not finite in 3 of 3072 pixels"):
        meter_ev(radiance, GROUND, METER)
