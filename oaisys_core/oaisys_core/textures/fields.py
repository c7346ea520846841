"""Tileable fields that textures are made of: noise, stones, cracks, shading by height."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.terrain.noise import Field, fractal, warped
from oaisys_core.types import FloatArray

OCCLUDING_SLOPE = 1.1
"""How deep a hollow, relative to its width, no longer sees half of the sky."""


class Stones(NamedTuple):
    """A layer of stones seen from above.

    Attributes:
        height: (N, N) float32, 0 where there is none, up to about 1 on the largest.
        ids: (N, N) int64, which stone; -1 where there is none.
    """

    height: Field
    ids: NDArray[np.int64]


def unit_grid(size_px: int, cells: int) -> tuple[FloatArray, FloatArray]:
    """Return (N, N) coordinates from 0 to ``cells`` at pixel centres of one tile."""
    axis = (np.arange(size_px) + 0.5) * (cells / size_px)
    x, y = np.meshgrid(axis, axis)
    return x, y


def tile_noise(
    size_px: int, cells: int, rng: np.random.Generator, octaves: int, kind: str = "fbm"
) -> Field:
    """Return (N, N) fractal noise that tiles, its largest features a ``cells``-th of the tile."""
    x, y = unit_grid(size_px, cells)
    return fractal(x, y, rng, octaves=octaves, kind=kind, period=cells, gain=0.55)


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


def stones(
    size_px: int, cells: int, rng: np.random.Generator, cover: float, radius: tuple[float, float]
) -> Stones:
    """Return irregular stones, at most one a cell of a jittered lattice.

    Args:
        size_px: Edge length of the tile.
        cells: Lattice cells along an edge.
        rng: Gives place, size, shape and turn of each stone.
        cover: Share of the cells that hold one.
        radius: Smallest and largest radius in cells, at most 0.9.
    """
    x, y = unit_grid(size_px, cells)
    x, y = _ragged(x, y, cells, rng)
    shape = (cells, cells)
    centre_x, centre_y = rng.uniform(0.2, 0.8, shape), rng.uniform(0.2, 0.8, shape)
    size = rng.uniform(*radius, shape) * (rng.uniform(size=shape) < cover)
    stretch = rng.uniform(0.65, 1.0, shape)
    turn = rng.uniform(0, np.pi, shape)
    facet = rng.uniform(-0.5, 0.5, (2, *shape))
    height = np.zeros((size_px, size_px), np.float32)
    ids = np.full((size_px, size_px), -1, np.int64)
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    for d_row in (-1, 0, 1):
        for d_column in (-1, 0, 1):
            c, r = column + d_column, row + d_row
            flat = (r % cells) * cells + c % cells
            dx = x - c - centre_x.ravel()[flat]
            dy = y - r - centre_y.ravel()[flat]
            cos, sin = np.cos(turn).ravel()[flat], np.sin(turn).ravel()[flat]
            reach = size.ravel()[flat] + 1e-6
            u = (cos * dx + sin * dy) / reach
            v = (cos * dy - sin * dx) / (reach * stretch.ravel()[flat])
            squared = u * u + v * v
            tilt = 1 + 0.35 * (facet[0].ravel()[flat] * u + facet[1].ravel()[flat] * v)
            dome = np.sqrt(np.maximum(1 - squared * squared, 0)) * reach * tilt
            higher = (dome > height) & (reach > 1e-3)
            height[higher] = dome[higher]
            ids[higher] = flat[higher]
    return Stones(height, ids)


def _ragged(
    x: FloatArray, y: FloatArray, cells: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates warped so that outlines are neither round nor smooth."""
    dx = fractal(x, y, rng, octaves=3, period=cells, gain=0.6)
    dy = fractal(x, y, rng, octaves=3, period=cells, gain=0.6)
    return x + 0.28 * dx, y + 0.28 * dy


def cracks(size_px: int, cells: int, rng: np.random.Generator, width: float) -> Field:
    """Return (N, N) depth of cracks between irregular plates: 1 in the middle of a crack, else 0.

    The borders of a Voronoi diagram: where the two nearest points are equally far (Worley, "A
    cellular texture basis function", SIGGRAPH 1996).
    """
    x, y = unit_grid(size_px, cells)
    x, y = _ragged(x, y, cells, rng)
    jitter = rng.uniform(0.1, 0.9, (2, cells, cells))
    nearest = np.full(x.shape, 9.0)
    second = np.full(x.shape, 9.0)
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
    _, y = warped_tile(x, y, rng)
    profile = np.interp(
        np.linspace(0, bands, 512, endpoint=False),
        np.arange(bands + 1),
        np.append(levels := rng.uniform(-1, 1, bands), levels[0]),
    )
    return np.asarray(profile[np.floor(y / 4 * 512).astype(np.int64) % 512], np.float32)


def warped_tile(
    x: FloatArray, y: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return coordinates of a tile of 4 cells, displaced by noise that tiles with it."""
    dx = fractal(x, y, rng, octaves=4, period=4)
    dy = fractal(x, y, rng, octaves=4, period=4)
    return x + 0.6 * dx, y + 0.6 * dy


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


__all__ = [
    "Stones",
    "blurred",
    "cracks",
    "grains",
    "normals_from_height",
    "occlusion",
    "stones",
    "strata",
    "tile_noise",
    "warped",
]
