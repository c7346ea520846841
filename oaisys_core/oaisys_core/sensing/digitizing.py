"""From radiance to the digital numbers of an image sensor, by the linear model of EMVA 1288.

Irradiance on the sensor is π / 4 · L · transmission / N² (a lens focused at infinity); photons per
band follow from the mean wavelength, electrons from the quantum efficiency. Electrons have shot
noise (Poisson), a pixel holds no more than a full well, reading adds Gaussian noise, and
K · electrons + black level is rounded and limited to the numbers that there are.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.scene.image_sensor import ImageSensor
from oaisys_core.types import BAYER, MONO16, RGB16, FloatArray

H_J_S, C_M_S = 6.62607015e-34, 2.99792458e8
"""Planck's constant and the speed of light (SI)."""

MEAN_WAVELENGTH_M = (648.2e-9, 549.5e-9, 451.7e-9)
"""Of sunlight's energy in the bands red, green and blue: ASTM G173-03, extraterrestrial, so that
energy divided by the photon energy there is the number of photons."""

SATURATED_SHARE = 0.01
"""Share of pixels that the meter lets saturate."""


def digitize(
    rate_e_s: FloatArray,
    modality: str,
    sensor: ImageSensor,
    exposure_time_s: float,
    noise_seed: int,
    name: str,
) -> NDArray[np.uint16]:
    """Return the digital numbers of what pixels collect.

    Args:
        rate_e_s: See `electrons_per_s`.
        modality: ``mono16``, ``rgb16`` or one of the Bayer patterns.
        sensor: The image sensor.
        exposure_time_s: For which it is exposed.
        noise_seed: Of the noise of this image.
        name: The camera's, on which the pixels' own gains and offsets depend.
    """
    light_e = _on_pixels(rate_e_s, modality) * exposure_time_s
    own = randomness.stream(0, f"{name}.image_sensor")
    gains = 1 + sensor.prnu * own.standard_normal(light_e.shape)
    offsets_e = sensor.dsnu_e * own.standard_normal(light_e.shape)
    mean_e = light_e * np.maximum(gains, 0) + sensor.dark_current_e_s * exposure_time_s
    rng = randomness.stream(noise_seed, f"{name}.{modality}")
    collected_e = np.minimum(_shot_noise(mean_e, rng), sensor.full_well_e)
    read_e = collected_e + offsets_e + sensor.read_noise_e * rng.standard_normal(light_e.shape)
    numbers = np.rint(sensor.gain * read_e + sensor.black_level_dn)
    return np.asarray(np.clip(numbers, 0, sensor.white_dn), np.uint16)


def electrons_per_s(radiance_w_m2_sr: NDArray[np.float32], sensor: ImageSensor) -> FloatArray:
    """Return the (H, W, 3) rate of electrons by band in pixels that see such radiance."""
    import cv2

    photon_j = H_J_S * C_M_S / np.array(MEAN_WAVELENGTH_M)
    collected = pi / 4 * sensor.transmission / sensor.f_number**2 * sensor.pixel_pitch_m**2
    factors = collected * np.array(sensor.quantum_efficiency) / photon_j
    rate = radiance_w_m2_sr.astype(np.float64) * factors
    if sensor.blur_px:
        rate = cv2.GaussianBlur(rate, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(rate)


def exposure_time_s(rate_e_s: FloatArray, modality: str, sensor: ImageSensor) -> float:
    """Return the exposure time of an image of such rates, see `electrons_per_s`: fixed, or metered.

    The meter's brings the mean to the sensor's target, but saturates at most `SATURATED_SHARE` of
    the pixels; it depends on this image alone.
    """
    if sensor.exposure_time_s is not None:
        return sensor.exposure_time_s
    rate = _on_pixels(rate_e_s, modality)
    mean, bright = float(rate.mean()), float(np.quantile(rate, 1 - SATURATED_SHARE))
    shortest_s, longest_s = sensor.exposure_limits_s
    if mean <= 0:
        return longest_s
    white_e = min((sensor.white_dn - sensor.black_level_dn) / sensor.gain, sensor.full_well_e)
    wanted_s = min(sensor.target * white_e / mean, white_e / max(bright, 1e-30))
    return min(max(wanted_s, shortest_s), longest_s)


def _on_pixels(rate: FloatArray, modality: str) -> FloatArray:
    """Return what each pixel collects of (H, W, 3) bands: all, or what its filter lets through."""
    if modality == RGB16:
        return rate
    if modality == MONO16:
        return np.asarray(rate.sum(axis=2))
    mosaic = np.empty(rate.shape[:2])
    for index, band in enumerate(BAYER[modality]):
        row, column = divmod(index, 2)
        mosaic[row::2, column::2] = rate[row::2, column::2, "rgb".index(band)]
    return mosaic


def _shot_noise(mean_e: FloatArray, rng: np.random.Generator) -> FloatArray:
    # numpy's Poisson numbers are limited to those of 64 bits.
    return np.asarray(rng.poisson(np.minimum(mean_e, 1e15)), np.float64)
