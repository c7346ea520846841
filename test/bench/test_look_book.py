"""The look book's figures against closed forms, and its list of pictures."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from repository import REPOSITORY

from oaisys_core.procedural.terrain.presets import PRESETS
from tools.gallery.look_book import figures, table
from tools.gallery.look_book.rendering import LookPicture, render_world
from tools.gallery.look_book.views import LOW_DEG, NOON_DEG, LookWorld, Viewpoint, look_worlds

HEIGHT, WIDTH = 240, 320


@pytest.mark.parametrize("exponent", [-1.5, -2.0, -2.5])
def test_the_slope_is_that_of_noise_with_a_power_law(exponent: float) -> None:
    rng = np.random.default_rng(3)
    radius = np.hypot(np.fft.fftfreq(HEIGHT)[:, None], np.fft.rfftfreq(WIDTH)[None, :])
    radius[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.normal(size=(HEIGHT, WIDTH))) * radius ** (exponent / 2)
    noise = np.fft.irfft2(spectrum, (HEIGHT, WIDTH))
    assert figures.spectral_slope(noise) == pytest.approx(exponent, abs=0.1)


def test_a_straight_horizon_leaves_nothing_and_a_wave_its_amplitude() -> None:
    rows, columns = np.indices((HEIGHT, WIDTH))
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    tilted = figures.horizon_rms_px(rows < 100 + columns // 4, nothing)
    assert tilted is not None
    # Steps of one pixel are all that is left, 0.29 px, at twice the width.
    assert tilted < 0.7
    wave = 8 * np.sin(2 * np.pi * columns / 40)
    waved = figures.horizon_rms_px(rows < 100 + wave, nothing)
    assert waved == pytest.approx(8 / 2**0.5 * 640 / WIDTH, rel=0.05)
    assert figures.horizon_rms_px(nothing, nothing) is None
    assert figures.horizon_rms_px(rows < 100, ~nothing) is None


def test_tiles_are_found_and_noise_is_not() -> None:
    rng = np.random.default_rng(5)
    land = np.ones((HEIGHT, WIDTH), bool)
    tile = rng.uniform(size=(40, 40))
    tiled = np.tile(tile, (HEIGHT // 40, WIDTH // 40))
    assert figures.repetition_peak(tiled, land) == pytest.approx(1.0, abs=0.1)
    assert figures.repetition_peak(rng.uniform(size=land.shape), land) < 0.1
    half = land.copy()
    half[: HEIGHT // 3] = False
    assert figures.repetition_peak(np.where(half, tiled, 5.0), half) == pytest.approx(1, abs=0.1)
    assert figures.repetition_peak(np.full(land.shape, 0.3), land) == 0.0


def test_a_checkerboard_has_the_stops_between_its_fields() -> None:
    fields = np.indices((HEIGHT, WIDTH)).sum(axis=0) // 16 % 2
    luminance = np.where(fields, 0.8, 0.1)
    assert figures.shadow_stops(luminance.ravel()) == pytest.approx(3.0)
    assert figures.shadow_stops(np.full(100, 0.4)) == 0.0


def test_histogram_and_colour_are_of_the_land() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    image[80:] = 51
    image[80:, ::2] = 204
    is_sky = np.indices((HEIGHT, WIDTH))[0] < 80
    found = figures.picture_figures(image, is_sky, np.zeros_like(is_sky))
    assert found["p5"] == pytest.approx(0.2)
    assert found["p95"] == pytest.approx(0.8)
    assert found["black"] == 0.0
    assert found["white"] == pytest.approx(1 / 3)
    assert found["colour"] == pytest.approx(0.0, abs=0.05)
    assert found["horizon"] == pytest.approx(0.0, abs=1e-6)
    text = figures.marks(found)
    assert text["white"] == "0.333*"
    assert text["5th percentile"] == "0.20"
    image[80:, ::2] = (200, 60, 60)
    lab = cv2.cvtColor(
        np.array([[[200, 60, 60], [51, 51, 51]]], np.float32) / 255, cv2.COLOR_RGB2LAB
    )[0]
    expected = np.sqrt(lab[:, 1].var() + lab[:, 2].var())
    assert figures.picture_figures(image, is_sky, ~is_sky)["colour"] == pytest.approx(
        expected, rel=1e-3
    )


def test_the_list_has_ten_presets_in_both_lights_and_five_worlds() -> None:
    worlds = list(look_worlds(REPOSITORY / "config" / "examples"))
    assert {world.name for world in worlds if isinstance(world.source, dict)} == set(PRESETS)
    for world in worlds:
        world.config()
    pictures = [(view.name, sun_deg) for world in worlds for view, sun_deg in world.views]
    assert len(pictures) >= 40
    for sun_deg in (NOON_DEG, LOW_DEG):
        assert {name for name, sun in pictures if sun == sun_deg} == {
            "standing",
            "30 m up",
            "200 m up",
        }


@pytest.mark.long
def test_a_world_is_rendered_with_its_figures_and_an_unknown_key_is_told(tmp_path: Path) -> None:
    known = {
        "stage": {"extent_m": 32.0, "resolution_px": 65, "surroundings": "plain"},
        "materials": {"texture_size_px": 64, "mask": {"size_px": 128}},
        "assets": {"rocks": []},
    }
    view = Viewpoint("above", (-8.0, -8.0), 3.0, 45.0, -4.0)
    book: list[LookPicture] = []
    for name, source in (("known", known), ("unknown", {"stage": {"presett": "mounds"}})):
        world = LookWorld(name, source, ((view, 30.0),))
        book += render_world(world, tmp_path, "analytic", "preview", "64x48")
    assert [each.file is None for each in book] == [False, True]
    assert "presett" in book[1].error
    lines = table.table(book).splitlines()
    assert "known: above, sun 30 deg" in lines[4]
    assert "not possible" in lines[5]
    table.write_json(tmp_path / "figures.json", book)
    written = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert written["pictures"][0]["figures"]["horizon"] is not None
    assert set(written["ranges"]) == set(figures.RANGES)
    table.write_sheet(tmp_path / "sheet.jpg", tmp_path, book)
    assert cv2.imread(str(tmp_path / "sheet.jpg")).shape == (196, 1920, 3)
