"""Where each layer of the ground's material lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from oaisys_core.scene import Ground
from oaisys_core.terrain.noise import Field, gradient_noise, spectral
from oaisys_core.types import FloatArray

RAGGED = 1.8
"""Fall of the noise's amplitudes with frequency; lower tears the patches' borders more."""

RELUCTANCE = 0.5
"""How much of a patch's score (whose deviation is 1) a condition that holds by 1/e takes away."""

OFFSET_STEPS, OFFSET_GAIN, OFFSET_STRIDE = 60, 0.5, 4
"""Search of the offsets that give layers their shares: steps, step size, texels left out."""

SLOPE_SCALE_M = 0.25
"""Slopes are taken of the ground smoothed by this deviation: pebbles do not make it steep."""

STEEP_DEG = 50.0
STEEP_SHARE = 0.002
"""A ground has steep parts where more than this share of it is steeper than the angle."""

COARSE_PX = 256
"""Grid on which a ground is looked at for steep parts."""


@dataclass(frozen=True)
class LayerNoise:
    """Noise that lays one layer over those before it.

    Attributes:
        scale: Cells along the ground's longer edge.
        detail: Octaves beyond the first; a fraction counts in part.
        roughness: Height of each octave relative to the one before.
        distortion: How far the noise is warped by other noise, in cells.
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
) -> NDArray[np.float32]:
    """Return (n_layers, size_px, size_px) float32 weights that sum to 1.

    Patches are about ``scale_m`` wide, their borders ragged down to single texels, with islands;
    each layer has a fair share of the ground. ``sharpness`` 0 gives wide transitions, 1 hard
    borders.

    Args:
        n_layers: How many.
        extent_m: Edge length of the ground.
        size_px: Edge length of the masks.
        rng: Gives the patches.
        scale_m: Size of a patch.
        sharpness: Of the borders.
        shares: Shares of the ground that the layers win before conditions; None: fair ones.
        gates: (n_layers, size_px, size_px) how far each layer may lie there, 0 to 1; where none
            may, the first one does.
    """
    if n_layers == 1:
        return np.ones((1, size_px, size_px), np.float32)
    waves = max(extent_m / (2 * scale_m), 1.0)
    scores = np.stack([_patches(size_px, waves, rng) for _ in range(n_layers)])
    if shares is not None:
        scores += _offsets(scores, shares)[:, None, None]
    if gates is not None:
        with np.errstate(divide="ignore"):
            scores += np.float32(RELUCTANCE) * np.log(_opened(gates))
    temperature = 0.6 * (1 - sharpness) ** 1.5 + 1e-3
    logits = scores / np.float32(temperature)
    logits -= logits.max(axis=0)
    weights = np.exp(logits)
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def layered_masks(
    noises: Sequence[LayerNoise],
    extent_m: tuple[float, float],
    size_px: int,
    rngs: Sequence[np.random.Generator],
    borders: tuple[float, float],
    *,
    shares: Sequence[float] | None = None,
    gates: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Return (L, size_px, size_px) float32 weights that sum to 1: layers laid one over another.

    Args:
        noises: One per layer; the first layer's is not used, as it lies everywhere.
        extent_m: Width and height of the ground.
        size_px: Edge length of the masks.
        rngs: One per layer, for its noise.
        borders: Where noise (0 to 1) begins to show a layer, and where it shows nothing else.
        shares: As in `blend_masks`: the noise's quantiles take the place of the borders' middle.
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
        weights *= _opened(gates)
        weights[0] += weights.sum(axis=0) == 0
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def gate(values: ArrayLike, bounds: tuple[float, float], soft: float) -> NDArray[np.float32]:
    """Return 1 inside bounds and 0 outside, over a linear ramp ``soft`` wide at each of them."""
    v = np.asarray(values, np.float64)
    width = max(soft, 1e-9)
    rising = np.clip((v - bounds[0]) / width + 0.5, 0, 1)
    falling = np.clip((bounds[1] - v) / width + 0.5, 0, 1)
    return np.asarray(np.minimum(rising, falling), np.float32)


def _opened(gates: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return gates of which one is open everywhere: the first layer's where all are shut."""
    opened = gates.copy()
    opened[0][gates.max(axis=0) <= 0] = 1
    return opened


def _offsets(scores: NDArray[np.float32], shares: Sequence[float]) -> NDArray[np.float32]:
    """Return (L,) what to add to scores so that each is the highest on its share of the ground."""
    wanted = np.log(np.asarray(shares) / sum(shares))
    few = scores[:, ::OFFSET_STRIDE, ::OFFSET_STRIDE].reshape(len(scores), -1)
    offsets = np.zeros(len(scores), np.float32)
    for _ in range(OFFSET_STEPS):
        winner = (few + offsets[:, None]).argmax(axis=0)
        count = np.maximum(np.bincount(winner, minlength=len(scores)), 1)
        offsets += (OFFSET_GAIN * (wanted - np.log(count / few.shape[1]))).astype(np.float32)
    return offsets


def _patches(size_px: int, waves: float, rng: np.random.Generator) -> Field:
    """Return noise that is above 0 on half of the ground, so that no layer is left out."""
    field = spectral(size_px, waves, rng, RAGGED)
    return np.asarray(field - np.median(field), np.float32)


def _unit_noise(
    noise: LayerNoise, extent_m: tuple[float, float], size_px: int, rng: np.random.Generator
) -> Field:
    """Return (size_px, size_px) noise of 0 to 1, most of it near 0.5, turned at random."""
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


class Relief(NamedTuple):
    """Heights and slopes at the texels of a mask, both (M, M) float32."""

    height_m: Field
    slope_rad: Field


def relief_of(ground: Ground, size_px: int) -> Relief:
    """Return a ground's relief at the centres of a size_px x size_px grid over its extent."""
    x0, y0, x1, y1 = ground.extent_m
    step_x, step_y = (x1 - x0) / size_px, (y1 - y0) / size_px
    centres = np.arange(size_px) + 0.5
    x, y = np.meshgrid(x0 + centres * step_x, y0 + centres * step_y)
    height_m = ground.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
    # A ground may have no surface at the edges of its extent.
    height_m = np.where(np.isfinite(height_m), height_m, np.nanmean(height_m))
    sigma = (SLOPE_SCALE_M / step_y, SLOPE_SCALE_M / step_x)
    smooth_m = gaussian_filter(height_m, sigma, mode="nearest")
    up_y, up_x = np.gradient(smooth_m, step_y, step_x)
    return Relief(height_m.astype(np.float32), np.arctan(np.hypot(up_x, up_y)).astype(np.float32))


def has_steep_parts(ground: Ground) -> bool:
    """Return whether textures laid on the ground from above would be drawn out visibly."""
    slope_rad = relief_of(ground, COARSE_PX).slope_rad
    return bool((slope_rad > np.radians(STEEP_DEG)).mean() > STEEP_SHARE)
