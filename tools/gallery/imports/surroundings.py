"""Grounds, textures and skies as people bring them, made by code."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

TEXTURE_PX, STONES = 512, 90
SKY_ROWS = 1024
SUN_ELEVATION_RAD, SUN_AZIMUTH_RAD = 0.14, 0.45
"""Of the panorama; azimuths from +x to +y."""

MODEL_PX, PIXEL_M = 401, 10.0
CRS, WEST_M, NORTH_M = "EPSG:32632", 662_000.0, 5_212_000.0
"""In the Alps, zone 32."""


def write_elevation(path: Path) -> None:
    """Write a GeoTIFF of a valley between ridges, in metres of a UTM zone."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:MODEL_PX, 0:MODEL_PX] / (MODEL_PX - 1)
    bend = 0.5 + 0.12 * np.sin(5.0 * y) + 0.05 * np.sin(11.0 * y + 1.0)
    aside = np.clip(np.abs(x - bend) - 0.05, 0, None)
    height = 1500.0 + 2600.0 * aside**1.5
    for octave in range(1, 7):
        size = 180.0 / 2**octave
        noise = gaussian_filter(rng.normal(size=(MODEL_PX, MODEL_PX)), size, mode="wrap")
        ridges = 1 - np.abs(noise) / np.abs(noise).max()
        height += 420.0 / 1.9**octave * ridges**2 * np.clip(aside * 5, 0.04, 1)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": CRS}
    place = from_origin(WEST_M, NORTH_M, PIXEL_M, PIXEL_M)
    with rasterio.open(
        path, "w", height=MODEL_PX, width=MODEL_PX, transform=place, **profile
    ) as file:
        file.write(height.astype(np.float32), 1)


def write_paving(folder: Path) -> None:
    """Write the maps of cobblestones, named as ambientCG does, with DirectX's normals."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(8)
    to_edge, stone = _stones(rng)
    dome = np.clip(to_edge / 0.035, 0, 1) ** 0.5
    grain = gaussian_filter(rng.normal(size=dome.shape), 1.2, mode="wrap")
    height = np.clip(0.8 * dome + 0.12 * rng.random(STONES)[stone] + 0.03 * grain, 0, 1)
    tones = np.array((128, 118, 106)) * (0.7 + 0.5 * rng.random((STONES, 1)))
    color = tones[stone] * (0.85 + 0.15 * dome[..., None]) * (1 + 0.08 * grain[..., None])
    joints = np.array((74, 66, 52)) * (1 + 0.25 * grain[..., None])
    color = np.where(dome[..., None] > 0.45, color, joints)
    slope_y, slope_x = np.gradient(np.pad(height, 1, mode="wrap"))
    across, down = -6.0 * slope_x[1:-1, 1:-1], -6.0 * slope_y[1:-1, 1:-1]
    normal = np.stack((across, down, np.ones_like(height)), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    rough = 0.55 + 0.4 * (1 - dome)
    name = "PavingStones001_1K-PNG"
    _write_png(folder / f"{name}_Color.png", color)
    _write_png(folder / f"{name}_NormalDX.png", 127.5 + 127.5 * normal)
    _write_png(folder / f"{name}_Displacement.png", 255 * height)
    _write_png(folder / f"{name}_Roughness.png", 255 * rough)


def _stones(rng: np.random.Generator) -> tuple[Array, NDArray[np.intp]]:
    """Return each pixel's distance from the nearest joint, in tiles, and its stone's number."""
    columns = int(np.sqrt(STONES))
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(STONES // columns)), -1)
    centres = (grid.reshape(-1, 2) + 0.5 + rng.uniform(-0.28, 0.28, (grid.size // 2, 2))) / (
        columns,
        STONES // columns,
    )
    shifts = [np.array((i, j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    around = np.concatenate([centres + shift for shift in shifts])
    y, x = (np.mgrid[0:TEXTURE_PX, 0:TEXTURE_PX] + 0.5) / TEXTURE_PX
    distance, index = cKDTree(around).query(np.stack((x, y), axis=-1), k=2)
    return (distance[..., 1] - distance[..., 0]) / 2, index[..., 0] % len(centres)


def _write_png(path: Path, values: Array) -> None:
    pixels = np.rint(np.clip(values, 0, 255)).astype(np.uint8)
    cv2.imwrite(str(path), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def write_panorama(path: Path) -> None:
    """Write a Radiance .hdr of an evening over mountains, with clouds and a low sun."""
    rng = np.random.default_rng(12)
    elevation = (np.pi * (0.5 - (np.arange(SKY_ROWS) + 0.5) / SKY_ROWS))[:, None]
    azimuth = (np.pi - np.pi * (np.arange(2 * SKY_ROWS) + 0.5) / SKY_ROWS)[None, :]
    towards = np.sin(elevation) * np.sin(SUN_ELEVATION_RAD) + np.cos(elevation) * np.cos(
        SUN_ELEVATION_RAD
    ) * np.cos(azimuth - SUN_AZIMUTH_RAD)
    angle = np.arccos(np.clip(towards, -1, 1))[..., None]
    up = np.clip(np.sin(elevation), 0, 1)[..., None]
    sky = np.array((0.10, 0.17, 0.36)) * up**0.45 + np.array((0.55, 0.33, 0.2)) * (1 - up) ** 5
    sky = sky + np.array((1.6, 0.75, 0.25)) * np.exp(-angle / 0.22)
    clouds = _clouds(rng, elevation)[..., None]
    lit = np.array((0.9, 0.5, 0.36)) * (0.35 + 1.3 * np.exp(-angle / 0.5))
    sky = sky * (1 - clouds) + lit * clouds
    sky = np.where(angle < 0.02, np.array((900.0, 640.0, 380.0)), sky)
    for mean, height, color in (
        (0.075, 0.06, (0.14, 0.12, 0.15)),
        (0.02, 0.05, (0.05, 0.04, 0.05)),
    ):
        top = mean + height * _skyline(rng, azimuth)
        # A pixel on the edge shows as much of the mountain as it covers.
        covered = np.clip((top - elevation) * SKY_ROWS / np.pi + 0.5, 0, 1)[..., None]
        sky = sky * (1 - covered) + np.array(color) * covered
    sky = np.where((elevation < 0)[..., None], np.array((0.10, 0.07, 0.05)), sky)
    cv2.imwrite(str(path), sky[..., ::-1].astype(np.float32))


def _clouds(rng: np.random.Generator, elevation: Array) -> Array:
    """Return how much of the sky behind is hidden: streaks that are thinner towards the zenith."""
    shape = (SKY_ROWS, 2 * SKY_ROWS)
    total = np.zeros(shape)
    for size in (48.0, 18.0, 8.0):
        noise = gaussian_filter(rng.normal(size=shape), (size / 3, size), mode=("nearest", "wrap"))
        total += size**0.7 * noise / noise.std()
    total /= total.std()
    fade = np.exp(-(((elevation - 0.3) / 0.28) ** 2))
    return np.asarray(np.clip(0.9 * total - 0.3, 0, 0.85) * fade)


def _skyline(rng: np.random.Generator, azimuth: Array) -> Array:
    height = np.zeros_like(azimuth)
    for waves in range(2, 60):
        phase = rng.uniform(0, 2 * np.pi)
        height = height + rng.normal() * np.cos(waves * azimuth + phase) / waves**1.1
    return np.asarray(height / np.abs(height).max())


def write_survey(path: Path) -> int:
    """Write a lawnmower of views straight down as a TUM trajectory; return their number."""
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    places = [(x, y) for row, y in enumerate((6.0, 0.0, -6.0)) for x in _row(row)]
    for number, (x, y) in enumerate(places):
        # Straight down, the upper edge of the image towards +y: a turn to the left, then down.
        lines.append(f"{number * 2.0:.1f} {x} {y} 18.0 -0.5 0.5 0.5 0.5")
    path.write_text("\n".join(lines) + "\n")
    return len(places)


def _row(number: int) -> list[float]:
    columns = [-12.0, -4.0, 4.0, 12.0]
    return columns[:: -1 if number % 2 else 1]
