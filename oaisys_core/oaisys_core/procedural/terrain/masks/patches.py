"""Weight masks of the ground's layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, log2, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.procedural.terrain.masks.cover import (
    cover_softness,
    tuft_deviation,
    tufts,
)
from oaisys_core.procedural.terrain.noise import (
    Field,
    balancing_offsets,
    band,
    gradient_noise,
    spectral,
)
from oaisys_core.types import FloatArray

RAGGED = 1.2
"""Exponent by which noise amplitudes fall with frequency; lower gives more ragged patches.

Patches whose octaves fade quickly have one clean outline each, and look like camouflage from above.
"""

PATCHES = 0.75
"""Weight of patches and regions beside what the ground's forms favour."""

LARGEST = 8.0
"""Size of the largest patches, in units of the patches whose size is given."""

OCTAVE = 0.5
"""Standard deviation of each octave of larger patches: as that of the patches of the given size."""

RELUCTANCE = 1.0
"""Reduction of a patch's score (standard deviation 1) where a condition holds by 1/e."""

NOWHERE = -1e6
"""Score of a layer that does not lie at a place, whatever the others have."""

WIDEST = 2.6
"""Width of the softest borders, in standard deviations of the patches' scores."""

MIN_WEIGHT = 0.04
"""Weight up to which a layer is left out."""

OFFSET_STRIDE = 4
"""Of the texels from which the offsets are found that give layers their shares."""


@dataclass(frozen=True)
class LayerNoise:
    """Noise that covers earlier layers with one layer.

    Attributes:
        scale: Cells along the ground's longer edge.
        detail: Number of octaves after the first; a fraction scales the last octave.
        roughness: Amplitude of each octave relative to the one before.
        distortion: Strength of the domain warp, in cells.
    """

    scale: float
    detail: float
    roughness: float
    distortion: float


def blend_masks(
    n_layers: int,
    extent_m: float,
    size_px: int,
    rng: np.random.Generator,
    scale_m: float,
    sharpness: float,
    *,
    shares: Sequence[float] | None = None,
    gates: NDArray[np.float32] | None = None,
    preferences: NDArray[np.float32] | None = None,
    green: Sequence[bool] | None = None,
    snowy: Sequence[bool] | None = None,
) -> NDArray[np.float32]:
    """Return (n_layers, size_px, size_px) float32 weights that sum to 1.

    Patches are about ``scale_m`` wide, with ragged borders and islands, and denser in some regions
    than in others; each layer has the same share of the ground. ``sharpness`` 0 gives wide
    transitions, 1 hard borders.

    Args:
        n_layers: Number of layers.
        extent_m: Edge length of the ground.
        size_px: Edge length of the masks.
        rng: Draws the patches.
        scale_m: Size of a patch.
        sharpness: Sharpness of the borders.
        shares: Shares of the layers before conditions apply; None for equal shares.
        gates: (n_layers, size_px, size_px) weights of the layers' conditions, 0 to 1; where all
            are 0, the first layer lies.
        preferences: (n_layers, size_px, size_px) by how much the ground's forms favour each layer,
            in standard deviations of the patches.
        green, snowy: Whether each layer is of plants or of snow, see `weights_of`; None for none.
    """
    if n_layers == 1:
        return np.ones((1, size_px, size_px), np.float32)
    waves = max(extent_m / (2 * scale_m), 1.0)
    is_green, is_snowy = (
        np.zeros(n_layers, np.bool_) if each is None else np.array(each, np.bool_)
        for each in (green, snowy)
    )
    scores = np.stack([_patches(size_px, waves, rng) for _ in range(n_layers)])
    deviation, texel_m = np.float32(tuft_deviation(sharpness)), extent_m / size_px
    for index in np.flatnonzero(is_green):
        scores[index] += deviation * tufts(size_px, texel_m, rng)
    if preferences is not None:
        scores += preferences
    few = scores[:, ::OFFSET_STRIDE, ::OFFSET_STRIDE]
    wanted = np.ones(n_layers) if shares is None else np.asarray(shares)
    scores += balancing_offsets(few, wanted)[:, None, None]
    if gates is not None:
        opened = _open_first(gates)
        scores += np.float32(RELUCTANCE) * np.log(np.maximum(opened, 1e-30))
        scores[opened <= 0] = NOWHERE
    narrow = cover_softness(sharpness, texel_m, bool(is_green.any()))
    return weights_of(scores, border_softness(sharpness), is_green | is_snowy, narrow)


def weights_of(
    scores: NDArray[np.float32],
    softness: float,
    is_cover: NDArray[np.bool_],
    of_tufts: FloatArray,
) -> NDArray[np.float32]:
    """Return (L, ...) weights that sum to 1, of layers that compete by their scores.

    Bare layers turn gradually into each other, but plants and snow have edges: thin snow between
    stones would look strewn. Layers of less than `MIN_WEIGHT` are left out, because each that is
    seen at a point costs time there.

    Args:
        scores: (L, ...); the weights replace them.
        softness: Width of the borders of bare layers, see `border_softness`.
        is_cover: (L,) whether a layer is of plants or of snow.
        of_tufts: Width of their borders, see `tuft_softness`: anything that broadcasts to (...).
    """
    wide, narrow = np.float32(softness), np.asarray(of_tufts, np.float32)
    if is_cover.any() and not is_cover.all():
        above = scores[is_cover].max(axis=0) - scores[~is_cover].max(axis=0)
        share = 1 / (1 + np.exp(-np.clip(above / narrow, -30, 30)))
        weights = scores
        weights[is_cover] = _compete(scores[is_cover], narrow) * share
        weights[~is_cover] = _compete(scores[~is_cover], wide) * (1 - share)
    else:
        weights = _compete(scores, narrow if is_cover.all() else wide)
    weights -= np.float32(min(MIN_WEIGHT, 0.5 / len(weights)))
    np.maximum(weights, 0, out=weights)
    weights /= weights.sum(axis=0)
    return weights


def _compete(scores: NDArray[np.float32], softness: Field | np.float32) -> NDArray[np.float32]:
    """Return (L, ...) weights that sum to 1 of layers of one kind; they replace the scores."""
    scores -= scores.max(axis=0)
    scores /= softness
    np.exp(scores, out=scores)
    scores /= scores.sum(axis=0)
    return scores


def border_softness(sharpness: float) -> float:
    """Return the width of the borders of bare layers, in standard deviations of their scores."""
    return float(WIDEST * (1 - sharpness) ** 1.5 + 1e-3)


def layer_masks(
    noises: Sequence[LayerNoise],
    extent_m: tuple[float, float],
    size_px: int,
    rngs: Sequence[np.random.Generator],
    borders: tuple[float, float],
    *,
    shares: Sequence[float] | None = None,
    gates: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return (L, size_px, size_px) float32 weights that sum to 1, each layer covering earlier ones.

    Args:
        noises: One per layer; that of the first layer, which lies everywhere, is not used.
        extent_m: Width and height of the ground.
        size_px: Edge length of the masks.
        rngs: One per layer, for its noise.
        borders: Noise values (0 to 1) between which a layer fades in.
        shares: As in `blend_masks`; quantiles of the noise replace the middle of ``borders``.
        gates: As in `blend_masks`.
    """
    weights = np.zeros((len(noises), size_px, size_px), np.float32)
    weights[0] = 1
    for index in range(1, len(noises)):
        noise = _unit_noise(noises[index], extent_m, size_px, rngs[index])
        middle, width = sum(borders) / 2, borders[1] - borders[0]
        if shares is not None:
            middle = float(np.quantile(noise, 1 - shares[index] / sum(shares[: index + 1])))
        cover = np.clip((noise - (middle - width / 2)) / max(width, 1e-6), 0, 1)
        if gates is not None:
            cover *= gates[index]
        weights[:index] *= 1 - cover
        weights[index] = cover
    if gates is not None:
        weights *= _open_first(gates)
        # Where nothing covers the ground, the first layer that may lie there does.
        first = np.argmax(gates > 0, axis=0)
        weights += (np.arange(len(weights))[:, None, None] == first) & (weights.sum(axis=0) == 0)
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def gate(values: ArrayLike, bounds: tuple[float, float], soft: float) -> NDArray[np.float32]:
    """Return 1 inside the bounds and 0 outside, with a linear ramp of width ``soft`` at each."""
    v = np.asarray(values, np.float64)
    width = max(soft, 1e-9)
    rising = np.clip((v - bounds[0]) / width + 0.5, 0, 1)
    falling = np.clip((bounds[1] - v) / width + 0.5, 0, 1)
    return np.asarray(np.minimum(rising, falling), np.float32)


def _open_first(gates: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the gates, with that of the first layer set to 1 where all are 0."""
    opened = gates.copy()
    opened[0][gates.max(axis=0) <= 0] = 1
    return opened


def _patches(size_px: int, waves: float, rng: np.random.Generator) -> Field:
    """Return noise whose patches lie closer in some regions, so that they do not look strewn."""
    field = spectral(size_px, waves, rng, RAGGED)
    larger = min(LARGEST, waves)
    if larger > 1:
        regions = band(size_px, waves / larger, waves, rng)
        field += np.float32(OCTAVE * sqrt(log2(larger))) * regions
    return np.float32(PATCHES) * field


def _unit_noise(
    noise: LayerNoise, extent_m: tuple[float, float], size_px: int, rng: np.random.Generator
) -> Field:
    """Return (size_px, size_px) noise of 0 to 1, mostly near 0.5, randomly rotated."""
    centres = (np.arange(size_px) + 0.5) / size_px
    x, y = np.meshgrid(*(centres * edge / max(extent_m) * noise.scale for edge in extent_m))
    angle = rng.uniform(0, 2 * np.pi)
    u = x * np.cos(angle) - y * np.sin(angle) + rng.uniform(0, 64)
    v = x * np.sin(angle) + y * np.cos(angle) + rng.uniform(0, 64)
    warp_u, warp_v = gradient_noise(u + 17.3, v, rng), gradient_noise(u, v + 31.7, rng)
    u, v = u + noise.distortion * warp_u, v + noise.distortion * warp_v
    total: FloatArray = np.zeros((size_px, size_px))
    norm = 0.0
    whole = floor(noise.detail) + 1
    for octave in range(whole + (noise.detail % 1 > 0)):
        amplitude = noise.roughness**octave * (1 if octave < whole else noise.detail % 1)
        total += amplitude * gradient_noise(u * 2**octave, v * 2**octave, rng)
        norm += amplitude
    return np.asarray(0.5 + 0.5 * np.clip(total / norm, -1, 1), np.float32)
