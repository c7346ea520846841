"""Tileable fields for textures: noise, cracks, layers, and shading by height."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field, fractal, spectral
from oaisys_core.procedural.textures.normal_maps import encode_normals
from oaisys_core.types import FloatArray

OCCLUDING_SLOPE = 1.1
"""Depth of a hollow, relative to its width, at which half of the sky is occluded."""


def unit_grid(size_px: int, cells: int) -> tuple[Field, Field]:
    """Return (N, N) coordinates from 0 to ``cells`` at the pixel centres of a tile."""
    axis = ((np.arange(size_px) + 0.5) * (cells / size_px)).astype(np.float32)
    x, y = np.meshgrid(axis, axis)
    return x, y


def tile_noise(size_px: int, cells: int, rng: np.random.Generator, rough: float = 1.85) -> Field:
    """Return (N, N) tileable fractal noise with standard deviation 1; see `spectral`."""
    return spectral(size_px, cells, rng, rough)


def crests(size_px: int, cells: int, rng: np.random.Generator, octaves: int = 5) -> Field:
    """Return (N, N) tileable ridged noise of 0 to 1: sharp crests between hollows."""
    x, y = unit_grid(size_px, cells)
    return fractal(x, y, rng, octaves=octaves, kind="ridged", period=cells, gain=0.55)


def grains(size_px: int, rng: np.random.Generator, width_px: float) -> Field:
    """Return (N, N) tileable noise with grains some pixels wide and standard deviation 1."""
    white = rng.standard_normal((size_px, size_px)).astype(np.float32)
    soft = blur(white, width_px)
    return soft / np.float32(soft.std() + 1e-9)


def blur(field: Field, sigma_px: float) -> Field:
    """Return a field after a Gaussian blur that wraps around the tile's edges."""
    import cv2

    pad = min(int(4 * sigma_px) + 1, field.shape[0])
    wrapped = np.pad(field, pad, mode="wrap")
    soft = cv2.GaussianBlur(wrapped, (0, 0), sigma_px)
    return np.asarray(soft[pad:-pad, pad:-pad], np.float32)


def warp(
    x: Field, y: Field, cells: int, rng: np.random.Generator, strength: float, rough: float = 2.4
) -> tuple[Field, Field]:
    """Return coordinates displaced by smooth tileable noise with std. deviation ``strength``."""
    dx, dy = (tile_noise(len(x), cells, rng, rough) for _ in range(2))
    return x + np.float32(strength) * dx, y + np.float32(strength) * dy


def cracks(size_px: int, cells: int, rng: np.random.Generator, width: float) -> Field:
    """Return (N, N) depth of cracks between irregular plates, from 0 to 1 in the middle of a crack.

    Cracks are the borders of a Voronoi diagram, where the two nearest points are equally far
    (Worley, "A cellular texture basis function", SIGGRAPH 1996).
    """
    x, y = unit_grid(size_px, cells)
    x, y = warp(x, y, cells, rng, 0.16)
    jitter = rng.uniform(0.1, 0.9, (2, cells, cells)).astype(np.float32)
    nearest = np.full(x.shape, 9.0, np.float32)
    second = np.full(x.shape, 9.0, np.float32)
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    for d_row in (-1, 0, 1):
        for d_column in (-1, 0, 1):
            c, r = column + d_column, row + d_row
            flat = (r % cells) * cells + c % cells
            distance = np.hypot(x - c - jitter[0].ravel()[flat], y - r - jitter[1].ravel()[flat])
            second = np.minimum(second, np.maximum(nearest, distance))
            nearest = np.minimum(nearest, distance)
    return np.asarray(np.clip(1 - (second - nearest) / width, 0, 1), np.float32)


def ripples(size_px: int, waves: tuple[int, int], rng: np.random.Generator, bend: float) -> Field:
    """Return (N, N) tileable waves of -1 to 1, with ``waves`` of them along x and y.

    ``bend`` is the deviation of a crest from a line, as a share of the tile.
    """
    x, y = unit_grid(size_px, 1)
    x, y = warp(x, y, 3, rng, bend)
    return np.asarray(np.sin(np.float32(2 * np.pi) * (waves[0] * x + waves[1] * y)), np.float32)


def narrow_band(
    size_px: int, waves: float, rng: np.random.Generator, spread: tuple[float, float]
) -> tuple[Field, Field]:
    """Return (N, N) phase (radians) and amplitude (mean 1) of tileable waves with defects.

    Random waves of similar length and direction, like wind ripples in sand. Where the amplitude
    vanishes, a crest ends or forks.

    Args:
        size_px: Edge length of the tile.
        waves: Waves along the tile's rows.
        rng: Draws the amplitudes.
        spread: Deviation of wave numbers along and across the waves, relative to ``waves``.
    """
    shape = (size_px, size_px)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    along = np.fft.fftfreq(size_px, 1 / size_px)[None, :]
    across = np.fft.fftfreq(size_px, 1 / size_px)[:, None]
    gain = np.exp(-0.5 * ((along - waves) / (spread[0] * waves)) ** 2)
    gain = gain * np.exp(-0.5 * (across / (spread[1] * waves)) ** 2)
    field = scipy.fft.ifft2(noise * gain)
    amplitude = np.abs(field)
    return (
        np.angle(field).astype(np.float32),
        (amplitude / amplitude.mean()).astype(np.float32),
    )


def windblown(
    size_px: int, rng: np.random.Generator, lowest: tuple[float, float], rough: float
) -> Field:
    """Return (N, N) tileable noise with standard deviation 1, stretched along the rows.

    Args:
        size_px: Edge length of the tile.
        rng: Draws the noise.
        lowest: Frequency of the largest features along and across the wind, in waves per tile.
        rough: Exponent by which amplitudes fall with frequency.
    """
    white = rng.standard_normal((size_px, size_px)).astype(np.float32)
    along = scipy.fft.rfftfreq(size_px, 1 / size_px)[None, :] / lowest[0]
    across = scipy.fft.fftfreq(size_px, 1 / size_px)[:, None] / lowest[1]
    relative = np.hypot(along, across).astype(np.float32)
    gain = np.where(relative >= 1, np.maximum(relative, 1) ** np.float32(-rough), relative**4)
    field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=white.shape)
    return np.asarray(field / (field.std() + 1e-12), np.float32)


def domes(size_px: int, centre: FloatArray, radius: FloatArray) -> Field:
    """Return (N, N) heights, in pixels, of half spheres on the tile, 0 elsewhere.

    Args:
        size_px: Edge length of the tile.
        centre: (D, 2) row and column, in pixels.
        radius: (D,) pixels.
    """
    result = np.zeros((size_px, size_px), np.float32)
    order = np.argsort(radius)
    for part in np.array_split(order, max(1, len(order) // 500)):
        half = int(np.ceil(radius[part].max(initial=0.0))) + 1
        offset = np.arange(-half, half + 1)
        corner = np.floor(centre[part]).astype(np.int64)
        v = corner[:, :1] + offset + 0.5 - centre[part, :1]
        u = corner[:, 1:] + offset + 0.5 - centre[part, 1:]
        square = v[:, :, None] ** 2 + u[:, None, :] ** 2
        high = np.sqrt(np.maximum(radius[part, None, None] ** 2 - square, 0))
        rows, columns = (corner[:, :1] + offset) % size_px, (corner[:, 1:] + offset) % size_px
        flat = rows[:, :, None] * size_px + columns[:, None, :]
        np.maximum.at(result.ravel(), flat.ravel(), high.astype(np.float32).ravel())
    return result


def spread(
    size_px: int,
    number: int,
    radius: tuple[float, float],
    exponent: float,
    rng: np.random.Generator,
    density: Field | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return random centres and power-law radii, in pixels, for `domes`.

    Args:
        size_px: Edge length of the tile.
        number: Number of candidates.
        radius: (smallest, largest) in tile edges.
        exponent: Exponent of the power law.
        rng: Draws positions and sizes.
        density: (N, N) probability, 0 to 1, that a candidate is kept; None keeps all.
    """
    centre = rng.uniform(0, size_px, (number, 2))
    share = rng.uniform(size=number) * (1 - (radius[0] / radius[1]) ** exponent)
    size = radius[0] * size_px * (1 - share) ** (-1 / exponent)
    if density is not None:
        row, column = centre.astype(np.intp).T
        stays = rng.uniform(size=number) < density[row, column]
        centre, size = centre[stays], size[stays]
    return centre, size


def occlusion(height: Field, radius_px: float) -> Field:
    """Return (N, N) factors, 0.35 to 1, that darken points below their surroundings."""
    hollow = blur(height, radius_px) - height
    scale = np.float32(OCCLUDING_SLOPE * radius_px / len(height))
    return np.asarray(np.clip(1 - np.maximum(hollow, 0) / scale, 0.35, 1), np.float32)


def normals_from_height(height: Field, relief_m: float, tile_m: float) -> NDArray[np.uint8]:
    """Return (N, N, 3) tangent-space normals (OpenGL: green up) of a tileable height map.

    Args:
        height: (N, N), row 0 at the top.
        relief_m: Height of a value of 1 in metres.
        tile_m: Edge length of the tile.
    """
    per_px = relief_m * len(height) / tile_m
    right = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * (per_px / 2)
    up = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) * (per_px / 2)
    upward = 1 / np.sqrt(1 + right**2 + up**2)
    return encode_normals(np.stack((-right * upward, -up * upward, upward), axis=-1))
