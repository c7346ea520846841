"""Relief of the land that is finer than its mesh: heights that light sees, but not depth.

The land's triangles are as large as a few dozen pixels of a camera on the stage. The relief below
that is laid over them as a bump map: one pattern in several sizes, each with the land's spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from oaisys_core import randomness
from oaisys_core.procedural.terrain.noise import Field, filter_noise
from oaisys_core.procedural.terrain.surroundings.form_noise import craters, ridges
from oaisys_core.procedural.terrain.surroundings.octaves import Shaper
from oaisys_core.procedural.terrain.surroundings.rings import SPACING_SHARE
from oaisys_core.procedural.terrain.surroundings.spectrum import Octave
from oaisys_core.scene.surroundings import ReliefBand
from oaisys_core.types import FloatArray

SHORTEST_M, RATIO, BANDS = 0.6, 10.0, 3
"""Shortest wavelength, ratio of the longest to the shortest one of a band, and number of bands."""

SIZE_PX, TEXELS = 512, 4
"""Size of the pattern, and texels of its shortest wave."""

FALL = 1.8
"""Exponent by which the pattern's amplitudes fall with frequency: crumbly ground."""

MIN_STEEPNESS, MAX_STEEPNESS = 0.005, 0.015
"""Bounds of the standard deviation of an octave over its wavelength: no ground is quite smooth."""

EXPONENT = 1.3
"""Exponent by which octaves shorter than the stage's grid have smaller deviations."""

LONGEST, WAVES = 12, 4
"""Forms along an edge of the pattern, of the largest size, and number of sizes."""

NOISE_SHARE = 0.4
"""Standard deviation of the noise on which the forms are, in units of the largest ones'."""

POINTS = 3.0
"""Points of the mesh per wavelength from which it has a wave itself."""

TURN_RAD = 0.9
"""Rotation of a band's pattern against that of the band before."""


@dataclass(frozen=True, eq=False)
class LandReliefPattern:
    """Relief below the resolution of the land's mesh.

    Attributes:
        octaves: Spectrum of the relief.
        seed: Seed of the places at which the pattern begins.
        shaped_by: What made the land's forms.
    """

    octaves: tuple[Octave, ...]
    seed: int
    shaped_by: Shaper = "water"

    @property
    def pattern(self) -> Field:
        """(SIZE_PX, SIZE_PX) tileable heights with standard deviation 1, the same in all worlds."""
        return _pattern(self.shaped_by)

    @property
    def bands(self) -> list[ReliefBand]:
        """The bands of wavelengths, the shortest first."""
        rng = randomness.stream(self.seed, "detail/bands")
        bands = []
        for index in range(BANDS):
            shortest_m = SHORTEST_M * RATIO**index
            start = rng.uniform(0, 1, 2)
            bands.append(
                ReliefBand(
                    period_m=shortest_m * SIZE_PX / TEXELS,
                    deviation_m=self._deviation_m(shortest_m),
                    complete_m=RATIO * shortest_m / (POINTS * SPACING_SHARE),
                    turn_rad=TURN_RAD * (index + 1),
                    start=(float(start[0]), float(start[1])),
                )
            )
        return bands

    def _deviation_m(self, shortest_m: float) -> float:
        """Return the standard deviation of the band that begins with a wavelength."""
        waves_m = shortest_m * 2.0 ** np.arange(np.log2(RATIO))
        known_m, deviations_m, shares = np.array(self.octaves).T
        deviations_m = shares * deviations_m
        found_m = np.exp(np.interp(np.log(waves_m), np.log(known_m), np.log(deviations_m + 1e-9)))
        found_m *= np.minimum(waves_m / known_m[0], 1.0) ** EXPONENT
        bounded_m = np.clip(found_m, MIN_STEEPNESS * waves_m, MAX_STEEPNESS * waves_m)
        return float(np.sqrt(np.sum(bounded_m**2)))


@lru_cache
def _pattern(shaped_by: Shaper) -> Field:
    """Return the pattern of lands of one kind; worlds begin it at places of their own."""
    rng = randomness.stream(0, "detail")
    cycles = np.hypot(
        np.fft.fftfreq(SIZE_PX, 1 / SIZE_PX)[:, None], np.fft.rfftfreq(SIZE_PX, 1 / SIZE_PX)
    )
    shortest = SIZE_PX / TEXELS
    gain = np.maximum(cycles, 1.0) ** -FALL
    gain *= np.clip(cycles * RATIO / shortest, 0, 1) ** 3 * (cycles <= shortest)
    pattern = filter_noise(SIZE_PX, gain.astype(np.float32), rng)
    if shaped_by != "wind":
        spectrum = np.fft.rfft2(_formed(pattern, shaped_by, rng)) * (cycles <= shortest)
        formed = np.fft.irfft2(spectrum, pattern.shape)
        pattern = np.asarray(formed / formed.std(), np.float32)
    pattern.setflags(write=False)
    return pattern


def _formed(noise: Field, shaped_by: Shaper, rng: np.random.Generator) -> FloatArray:
    """Return (SIZE_PX, SIZE_PX) tileable heights with gullies or craters of several sizes on noise.

    Args:
        noise: The same of noise.
        shaped_by: What made the forms.
        rng: Draws them.
    """
    height = NOISE_SHARE * noise.astype(np.float64)
    places = np.indices(noise.shape)[::-1].reshape(2, -1).T / SIZE_PX
    slope = np.stack([_slope(noise, axis) for axis in (1, 0)], axis=-1).reshape(-1, 2)
    for wave in range(WAVES):
        period = LONGEST * 2**wave
        strength = 2.0 ** ((1 - FALL) * wave)
        if shaped_by == "impacts":
            height += strength * craters(period * places, rng, period).reshape(noise.shape)
            continue
        forms = ridges(period * places, slope, rng, period)
        height += strength * forms.height.reshape(noise.shape)
        slope = slope + strength * period / SIZE_PX * forms.slope
    return height


def _slope(noise: Field, axis: int) -> FloatArray:
    """Return the slopes of a tileable field's long waves along an axis, per cell."""
    smooth = scipy.ndimage.gaussian_filter(noise, SIZE_PX / LONGEST / 4, mode="wrap")
    return np.asarray(np.roll(smooth, -1, axis) - np.roll(smooth, 1, axis), np.float64) / 2
