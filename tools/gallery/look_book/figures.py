"""Figures of a picture beside those of photographs of natural scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.types import FloatArray

Image = NDArray[np.uint8]
"""(H, W, 3) uint8 sRGB."""

Mask = NDArray[np.bool_]
"""(H, W)."""

DARKEST, BRIGHTEST = 2, 253
"""Values of the luma up to which, and from which, a pixel counts as clipped."""

SPECTRUM = (0.02, 0.4)
"""Frequencies in cycles per pixel over which the slope of the power spectrum is fitted."""

BANDS = 24
COARSE_SHARE = 0.04
"""Standard deviation, as a share of the width, of the blur that hides what does not repeat."""

MIN_LAG_PX, MIN_OVERLAP = 6, 0.25
MIN_LAND_SHARE = 0.05
"""Share of a picture that must be land; without it, there are no figures of land."""

MIN_HORIZON_SHARE = 0.3
"""Share of the columns in which a horizon must be seen."""

DARK_LUMINANCE = 1e-3


@dataclass(frozen=True)
class Range:
    """A figure's name, and the values that are believed.

    Attributes:
        least: Lower limit.
        most: Upper limit.
        digits: Decimals that are printed.
        meaning: What it is.
    """

    name: str
    least: float
    most: float
    digits: int
    meaning: str

    def mark(self, value: float | None) -> str:
        """Return the value as text, with an asterisk where it is out of the range."""
        if value is None:
            return "-"
        mark = "" if self.least <= value <= self.most else "*"
        return f"{value:.{self.digits}f}{mark}"


RANGES = {
    "p5": Range("5th percentile", 0.02, 0.45, 2, "luma of the land, 0 to 1"),
    "p95": Range("95th percentile", 0.45, 0.98, 2, "luma of the land, 0 to 1"),
    "black": Range("black", 0.0, 0.02, 3, "share of the land that is clipped"),
    "white": Range("white", 0.0, 0.02, 3, "share of the picture that is clipped"),
    "slope": Range("slope", -2.3, -1.9, 2, "exponent of frequency in the power of luminance"),
    "colour": Range("colour", 3.0, 40.0, 1, "root of the variance of a* and b* of the land"),
    "repetition": Range("repetition", 0.0, 0.1, 2, "highest peak of the autocorrelation"),
    "shadow": Range("shadow", 1.0, 6.0, 1, "stops between the bright and the dark land"),
    "horizon": Range("horizon", 1.0, 1e9, 1, "RMS from a line, in px of a picture 640 px wide"),
}
"""Of the slope, averages over photographs: 1.81 (Ruderman and Bialek, Phys. Rev. Lett. 73, 1994),
1.88 (van der Schaaf and van Hateren, Vision Research 36, 1996), 2.2 (Field, J. Opt. Soc. Am. A 4,
1987), 2.4 (Tolhurst et al., Ophthalmic Physiol. Opt. 12, 1992); their single pictures reach from
1.6 to 3.0. The other limits are our own."""


def picture_figures(image: Image, is_sky: Mask, is_object: Mask) -> dict[str, float | None]:
    """Return the figures of `RANGES`; None where the picture has no such thing.

    Args:
        image: The picture.
        is_sky: Where no surface is.
        is_object: Where a surface is no ground; such columns are not counted for the horizon.
    """
    land = ~is_sky
    luma = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    luminance = linear(image / 255.0) @ (0.2126, 0.7152, 0.0722)
    found: dict[str, float | None] = dict.fromkeys(RANGES)
    found["white"] = float(np.mean(luma >= BRIGHTEST))
    found["slope"] = spectral_slope(luminance)
    found["horizon"] = horizon_rms_px(is_sky, is_object)
    if land.mean() >= MIN_LAND_SHARE:
        low, high = np.percentile(luma[land] / 255.0, (5, 95))
        found |= {"p5": float(low), "p95": float(high)}
        found["black"] = float(np.mean(luma[land] <= DARKEST))
        found["colour"] = color_deviation(image, land)
        found["repetition"] = repetition_peak(luminance, land)
        found["shadow"] = shadow_stops(luminance[land])
    return found


def spectral_slope(luminance: FloatArray) -> float:
    """Return the exponent of frequency in the power spectrum, averaged over directions.

    The picture's contrast has a Hann window, and its means over bands of equal width in the
    logarithm of frequency are fitted.
    """
    height, width = luminance.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    mean = float((luminance * window).sum() / window.sum())
    power = np.abs(np.fft.fft2((luminance - mean) * window)) ** 2
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None, :])
    borders = np.geomspace(*SPECTRUM, BANDS + 1)
    band = np.digitize(radius.ravel(), borders)
    count = np.bincount(band, minlength=BANDS + 2)[1:-1]
    total = np.bincount(band, power.ravel(), BANDS + 2)[1:-1]
    log_radius = np.bincount(band, np.log(np.maximum(radius.ravel(), 1e-9)), BANDS + 2)[1:-1]
    used = (count > 0) & (total > 0)
    if used.sum() < 2:
        return 0.0
    slope, _ = np.polyfit(log_radius[used] / count[used], np.log(total[used] / count[used]), 1)
    return float(slope)


def color_deviation(image: Image, land: Mask) -> float:
    """Return the root of the summed variances of a* and b* (CIELAB), 0 for one hue."""
    lab = cv2.cvtColor((image / 255.0).astype(np.float32), cv2.COLOR_RGB2LAB)
    return float(np.sqrt(lab[..., 1][land].var() + lab[..., 2][land].var()))


def repetition_peak(luminance: FloatArray, land: Mask) -> float:
    """Return the highest peak of the land's autocorrelation beside the centre, 1 for exact tiles.

    What is coarser than `COARSE_SHARE` of the width is taken away, each shift is normalised by the
    land that overlaps, and shifts of less than `MIN_OVERLAP` of it are not counted.
    """
    weight = land.astype(np.float64)
    sigma = COARSE_SHARE * luminance.shape[1]
    coarse = cv2.GaussianBlur(luminance * weight, (0, 0), sigma)
    share = np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6)
    fine = (luminance - coarse / share) * weight
    # Twice the size, so that shifts do not wrap around.
    size = (2 * luminance.shape[0], 2 * luminance.shape[1])
    pairs = _autocorrelation(weight, size)
    total = _autocorrelation(fine, size)
    if total[0, 0] <= 1e-12 * pairs[0, 0]:
        return 0.0
    variance = total[0, 0] / pairs[0, 0]
    correlation = np.fft.fftshift(total / np.maximum(pairs, 1.0) / variance)
    overlap = np.fft.fftshift(pairs) / pairs[0, 0]
    middle = np.array(correlation.shape) // 2
    rows, columns = np.indices(correlation.shape, sparse=True)
    lag_px = np.hypot(rows - middle[0], columns - middle[1])
    highest = cv2.dilate(correlation, np.ones((5, 5), np.uint8))
    peaks = (correlation >= highest) & (lag_px >= MIN_LAG_PX) & (overlap >= MIN_OVERLAP)
    return float(max(0.0, correlation[peaks].max(initial=0.0)))


def _autocorrelation(values: FloatArray, size: tuple[int, int]) -> FloatArray:
    return np.asarray(np.fft.irfft2(np.abs(np.fft.rfft2(values, size)) ** 2, size))


def shadow_stops(luminance: FloatArray) -> float:
    """Return the stops between the means of the bright and the dark part of some pixels.

    Otsu's threshold of the logarithm of luminance divides them.
    """
    stops = np.log2(np.maximum(luminance, DARK_LUMINANCE))
    low, high = float(stops.min()), float(stops.max())
    if high - low < 1e-6:
        return 0.0
    levels = np.rint((stops - low) / (high - low) * 255).astype(np.uint8)
    threshold, _ = cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    bright = levels > threshold
    return float(stops[bright].mean() - stops[~bright].mean())


def horizon_rms_px(is_sky: Mask, is_object: Mask) -> float | None:
    """Return the RMS distance of the horizon from a fitted line, in px of a picture 640 px wide.

    The horizon is the border of the sky above; only columns whose border is ground are used.
    """
    height, width = is_sky.shape
    below = np.argmax(~is_sky, axis=0)
    columns = np.arange(width)
    seen = (below > 0) & ~is_sky.all(axis=0) & ~is_object[np.minimum(below, height - 1), columns]
    if seen.mean() < MIN_HORIZON_SHARE:
        return None
    x, y = columns[seen].astype(float), below[seen].astype(float)
    residual = y - np.polyval(np.polyfit(x, y, 1), x)
    return float(np.sqrt(np.mean(residual**2)) * 640 / width)


def marks(figures: Mapping[str, float | None]) -> dict[str, str]:
    """Return all figures as text, with an asterisk at those out of the range."""
    return {RANGES[key].name: RANGES[key].mark(value) for key, value in figures.items()}
