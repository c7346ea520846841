"""Digital numbers against EMVA 1288's own relations, with its photon transfer method.

Numbers of photons are checked against the spectrum of a black body at the sun's temperature, which
is nearly that of sunlight within a band.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.sensing.image_sensor import ImageSensorConfig
from oaisys_core.errors import ConfigError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.sensing.digitizing import digitize, electrons_per_s, exposure_time_s
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

SENSOR = ImageSensorConfig(exposure_time_s=0.001, prnu=0.0, dsnu_e=0.0, bits=16).image_sensor
"""It has 2,600 electrons of 1 W/(m² sr) in each band."""
SHAPE = (200, 200, 3)


def flat(level: float) -> NDArray[np.float32]:
    return np.full(SHAPE, level, np.float32)


def numbers(level: float, seed: int = 1, sensor: Any = SENSOR, kind: str = "mono16") -> Any:
    rate_e_s = electrons_per_s(flat(level), sensor)
    time_s = exposure_time_s(rate_e_s, kind, sensor)
    return digitize(rate_e_s, kind, sensor, time_s, seed, "camera").astype(np.float64)


def test_photons_are_those_of_a_black_body() -> None:
    """Of 5772 K, scaled to the energy in each band."""

    def planck(wavelength_m: float) -> float:
        return float(wavelength_m**-5 / np.expm1(0.014387769 / (wavelength_m * 5772)))

    perfect = replace(SENSOR, quantum_efficiency=(1.0, 1.0, 1.0), transmission=1.0)
    rate = electrons_per_s(np.ones((1, 1, 3), np.float32), perfect)[0, 0]
    # π / 4 / N² of the radiance reaches the sensor.
    power_w = pi / 4 / SENSOR.f_number**2 * SENSOR.pixel_pitch_m**2
    for found, (least, most) in zip(rate, ((6e-7, 7e-7), (5e-7, 6e-7), (4e-7, 5e-7)), strict=True):
        energy, _ = quad(planck, least, most, epsabs=0)
        photons, _ = quad(lambda x: planck(x) * x / 1.98644586e-25, least, most, epsabs=0)
        assert found == pytest.approx(power_w * photons / energy, rel=0.005)


def test_the_photon_transfer_curve_gives_gain_and_noise() -> None:
    """The variance of differences of two images by their mean (EMVA 1288, 6.6)."""
    sensor = replace(SENSOR, full_well_e=20_000.0)
    levels = np.linspace(0.0, 3.0, 9)
    pairs = [(numbers(level, 1, sensor), numbers(level, 2, sensor)) for level in levels]
    means = np.array([(a + b).mean() / 2 for a, b in pairs])
    variances = np.array([(a - b).var() / 2 for a, b in pairs])
    gain, offset = np.polyfit(means - means[0], variances, 1)
    assert gain == pytest.approx(sensor.gain, rel=0.02)
    dark_e2 = sensor.read_noise_e**2 + sensor.dark_current_e_s * 0.001
    assert variances[0] == pytest.approx(sensor.gain**2 * dark_e2 + 1 / 12, rel=0.03)
    assert offset == pytest.approx(variances[0], rel=0.5)


def test_numbers_are_linear_in_exposure_time_up_to_the_full_well() -> None:
    dark = replace(SENSOR, read_noise_e=0.0, dark_current_e_s=0.0)
    times_s = (0.0005, 0.001, 0.002)
    means = [numbers(1.0, 1, replace(dark, exposure_time_s=each)).mean() for each in times_s]
    signal = np.array(means) - dark.black_level_dn
    np.testing.assert_allclose(signal / signal[0], [1, 2, 4], rtol=0.005)
    expected_e = electrons_per_s(flat(1.0), dark).sum(axis=2).mean() * 0.002
    assert signal[2] == pytest.approx(dark.gain * expected_e, rel=0.005)
    full = numbers(1e6, 1, dark)
    assert (full == dark.white_dn).all()


def test_pixels_keep_their_own_gain_and_offset() -> None:
    uneven = replace(SENSOR, prnu=0.01, dsnu_e=5.0, read_noise_e=0.0, dark_current_e_s=0.0)
    dark = numbers(0.0, 1, uneven) - uneven.black_level_dn
    assert dark.std() == pytest.approx(5.0 * uneven.gain, rel=0.05)
    assert np.array_equal(dark, numbers(0.0, 2, uneven) - uneven.black_level_dn)
    many = np.mean([numbers(2.0, seed, uneven) for seed in range(40)], axis=0)
    own = many - uneven.black_level_dn - dark
    assert own.std() / own.mean() == pytest.approx(0.01, rel=0.15)


@pytest.mark.parametrize(
    ("kind", "bands"),
    [
        ("bayer_rggb16", [[0, 1], [1, 2]]),
        ("bayer_bggr16", [[2, 1], [1, 0]]),
        ("bayer_gbrg16", [[1, 2], [0, 1]]),
        ("bayer_grbg16", [[1, 0], [2, 1]]),
    ],
)
def test_each_pixel_of_a_mosaic_has_its_band(kind: str, bands: list[list[int]]) -> None:
    quiet = replace(SENSOR, read_noise_e=0.0, dark_current_e_s=0.0, quantum_efficiency=(1, 1, 1))
    light = np.zeros(SHAPE, np.float32)
    light[...] = (0.5, 1.0, 2.0)
    rate_e_s = electrons_per_s(light, quiet)
    found = digitize(rate_e_s, kind, quiet, 0.004, 1, "camera").astype(float)
    found -= quiet.black_level_dn
    of_bands = quiet.gain * rate_e_s[0, 0] * 0.004
    for row, column in np.ndindex(2, 2):
        mean = found[row::2, column::2].mean()
        assert mean == pytest.approx(of_bands[bands[row][column]], rel=0.01)


def test_the_meter_brings_the_mean_to_its_target() -> None:
    metered = ImageSensorConfig(target=0.4).image_sensor
    for level in (0.01, 1.0, 100.0):
        share = numbers(level, 1, metered).mean() / metered.white_dn
        assert share == pytest.approx(0.4 + metered.black_level_dn / metered.white_dn, abs=0.01)
    dark, glare = (electrons_per_s(flat(level), metered) for level in (0.0, 1e9))
    assert exposure_time_s(dark, "mono16", metered) == 1.0
    assert exposure_time_s(glare, "mono16", metered) == 1e-5


def test_light_spreads_over_neighbours_and_none_is_lost() -> None:
    point = np.zeros((41, 41, 3), np.float32)
    point[20, 20] = 100.0
    sharp, blurred = (electrons_per_s(point, replace(SENSOR, blur_px=px)) for px in (0.0, 2.0))
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=1e-3)
    rows = np.arange(41) - 20
    spread = (blurred[..., 1].sum(axis=1) * rows**2).sum() / blurred[..., 1].sum()
    assert np.sqrt(spread) == pytest.approx(2.0, rel=0.05)


def test_samples_have_numbers_and_their_exposure_times() -> None:
    camera = {"width_px": 16, "height_px": 12, "modalities": ["rgb", "mono16", "bayer_rggb16"]}
    stage = {"preset": "plane", "extent_m": 10.0, "resolution_px": 9}
    sections: dict[str, Any] = {"stage": stage, "sensors": {"cameras": [camera]}}
    config = config_from_mapping({"backend": "analytic", "assets": {"rocks": []}, **sections})
    simulation = Simulation(config)
    simulation.step_batch()
    sensor: Any = {"pose": pose_looking_down(0.0, 0.0, 2.0)}
    first, second = (simulation.step_sample(ModuleMetadata(sensor=sensor)) for _ in range(2))
    mono = first.frame("camera", "mono16").data
    assert mono.dtype == np.uint16
    assert 0.1 < mono.mean() / 4095 < 0.5
    assert not np.array_equal(mono, second.frame("camera", "mono16").data), "noise is drawn anew"
    assert '"camera.mono16.exposure_time_s": ' in first.provenance.exposures_json


@pytest.mark.parametrize(
    ("values", "field"),
    [
        ({"bits": 9}, "bits"),
        ({"min_exposure_s": 0.1, "max_exposure_s": 0.01}, "max_exposure_s"),
        ({"bits": 8, "black_level_dn": 300}, "black_level_dn"),
        ({"quantum_efficiency": [0.5, 1.2, 0.5]}, "quantum_efficiency"),
        ({"exposure_time_s": "meter"}, "exposure_time_s"),
    ],
)
def test_what_no_sensor_has_is_refused(values: dict[str, Any], field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        config_from_mapping({"sensors": {"cameras": [{"image_sensor": values}]}})
