"""Tileable fields that textures are made of: noise, cracks, layers, shading by height."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import Field, fractal, spectral

OCCLUDING_SLOPE = 1.1
"""How deep a hollow, relative to its width, no longer sees half of the sky."""


def unit_grid(size_px: int, cells: int) -> tuple[Field, Field]:
    """Return (N, N) coordinates from 0 to ``cells`` at pixel centres of one tile."""
    axis = ((np.arange(size_px) + 0.5) * (cells / size_px)).astype(np.float32)
    x, y = np.meshgrid(axis, axis)
    return x, y


def tile_noise(size_px: int, cells: int, rng: np.random.Generator, rough: float = 1.85) -> Field:
    """Return (N, N) fractal noise that tiles, of standard deviation 1; see `spectral`."""
    return spectral(size_px, cells, rng, rough)


def crests(size_px: int, cells: int, rng: np.random.Generator, octaves: int = 5) -> Field:
    """Return (N, N) ridged noise of 0 to 1 that tiles: sharp crests between hollows."""
    x, y = unit_grid(size_px, cells)
    return fractal(x, y, rng, octaves=octaves, kind="ridged", period=cells, gain=0.55)


def grains(size_px: int, rng: np.random.Generator, width_px: float) -> Field:
    """Return (N, N) noise of grains some pixels wide, of standard deviation 1, that tiles."""
    white = rng.standard_normal((size_px, size_px)).astype(np.float32)
    soft = blurred(white, width_px)
    return soft / np.float32(soft.std() + 1e-9)


def blurred(field: Field, sigma_px: float) -> Field:
    """Return a field after a Gaussian blur that wraps around the tile's edges."""
    pad = min(int(4 * sigma_px) + 1, field.shape[0])
    wrapped = np.pad(field, pad, mode="wrap")
    soft = cv2.GaussianBlur(wrapped, (0, 0), sigma_px)
    return np.asarray(soft[pad:-pad, pad:-pad], np.float32)


def _warped(
    x: Field, y: Field, cells: int, rng: np.random.Generator, strength: float
) -> tuple[Field, Field]:
    """Return coordinates displaced by smooth, tiling noise of standard deviation ``strength``."""
    dx, dy = (tile_noise(len(x), cells, rng, 2.4) for _ in range(2))
    return x + np.float32(strength) * dx, y + np.float32(strength) * dy


def cracks(size_px: int, cells: int, rng: np.random.Generator, width: float) -> Field:
    """Return (N, N) depth of cracks between irregular plates: 1 in the middle of a crack, else 0.

    The borders of a Voronoi diagram: where the two nearest points are equally far (Worley, "A
    cellular texture basis function", SIGGRAPH 1996).
    """
    x, y = unit_grid(size_px, cells)
    x, y = _warped(x, y, cells, rng, 0.16)
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


def strata(size_px: int, bands: int, rng: np.random.Generator) -> Field:
    """Return (N, N) wavy layers of -1 to 1 along the tile's rows, ``bands`` of them, that tile."""
    x, y = unit_grid(size_px, 4)
    _, y = _warped(x, y, 4, rng, 0.15)
    profile = np.interp(
        np.linspace(0, bands, 512, endpoint=False),
        np.arange(bands + 1),
        np.append(levels := rng.uniform(-1, 1, bands), levels[0]),
    )
    return np.asarray(profile[np.floor(y / 4 * 512).astype(np.int64) % 512], np.float32)


def ripples(size_px: int, waves: tuple[int, int], rng: np.random.Generator, bend: float) -> Field:
    """Return (N, N) wavy crests of -1 to 1 that tile, ``waves`` of them along x and y.

    ``bend`` is how far a crest strays, as a share of the tile.
    """
    x, y = unit_grid(size_px, 1)
    x, y = _warped(x, y, 3, rng, bend)
    return np.asarray(np.sin(np.float32(2 * np.pi) * (waves[0] * x + waves[1] * y)), np.float32)


def occlusion(height: Field, radius_px: float) -> Field:
    """Return (N, N) factors that darken what lies lower than its surroundings, 0.35 to 1."""
    hollow = blurred(height, radius_px) - height
    scale = np.float32(OCCLUDING_SLOPE * radius_px / len(height))
    return np.asarray(np.clip(1 - np.maximum(hollow, 0) / scale, 0.35, 1), np.float32)


def normals_from_height(height: Field, relief_m: float, tile_m: float) -> NDArray[np.uint8]:
    """Return (N, N, 3) tangent-space normals (OpenGL: green up) of a tileable height map.

    Args:
        height: (N, N), row 0 at the top.
        relief_m: What 1 in ``height`` stands for.
        tile_m: Edge length of the tile.
    """
    per_px = relief_m * len(height) / tile_m
    right = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) * (per_px / 2)
    up = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) * (per_px / 2)
    normal = np.stack((-right, -up, np.ones_like(height)), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(np.rint((normal * 0.5 + 0.5) * 255), np.uint8)
