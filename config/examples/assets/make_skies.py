"""Makes the sky image and its label map beside this file: `python make_skies.py [FOLDER]`.

An afternoon over a ring of hills, small on purpose: 0.75 degrees to a texel.
"""

# ruff: noqa: INP001 - a script, not a package

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
from numpy.typing import NDArray

ROWS = 240
SUN_ELEVATION, SUN_AZIMUTH = np.radians((24.0, 50.0))
SUN_RADIUS = np.radians(1.2)
SUN_W_M2 = 3.5
"""Irradiance of the sun on a surface that faces it."""

ZENITH, HORIZON, GLOW = (0.10, 0.19, 0.42), (0.52, 0.55, 0.55), (1.2, 0.95, 0.6)
FINER = 4
"""Places across a texel, whose mean is its colour."""

NEAR_HILLS, FAR_HILLS, PLAIN = (0.16, 0.12, 0.085), (0.30, 0.29, 0.30), (0.24, 0.19, 0.14)
COLORS_OF_LABELS = {"sky": (120, 170, 255), "hills": (150, 90, 40), "plain": (220, 190, 120)}
SKY, HILLS, GROUND = range(3)


def ridge(rng: np.random.Generator, azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return heights from -1 to 1 that come round to where they began."""
    height = np.zeros_like(azimuth)
    for waves in range(2, 40):
        height += rng.normal() * np.cos(waves * azimuth + rng.uniform(0, 2 * np.pi)) / waves**1.3
    return height / np.abs(height).max()


def sky_image(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return (ROWS, 2 ROWS, 3) radiance and (ROWS, 2 ROWS) what it shows."""
    rows = ROWS * FINER
    elevation = (np.pi * (0.5 - (np.arange(rows) + 0.5) / rows))[:, None]
    azimuth = (np.pi - np.pi * (np.arange(2 * rows) + 0.5) / rows)[None, :]
    towards_sun = np.sin(elevation) * np.sin(SUN_ELEVATION) + np.cos(elevation) * np.cos(
        SUN_ELEVATION
    ) * np.cos(azimuth - SUN_AZIMUTH)
    angle = np.arccos(np.clip(towards_sun, -1, 1))[..., None]
    share = np.sqrt(np.maximum(np.sin(elevation), 0.0))[..., None]
    image = np.array(HORIZON) * (1 - share) + np.array(ZENITH) * share
    image = image + np.array(GLOW) * np.exp(-angle / 0.18)
    is_sun = angle[..., 0] < SUN_RADIUS
    solid_angle = (np.cos(elevation) * (np.pi / rows) ** 2 * is_sun).sum()
    image[is_sun] += SUN_W_M2 / solid_angle * np.array((1.0, 0.93, 0.82))

    shown = np.full(is_sun.shape, SKY)
    for color, mean_deg, range_deg in ((FAR_HILLS, 6.0, 4.0), (NEAR_HILLS, 2.0, 5.0)):
        top = np.radians(mean_deg + range_deg * ridge(rng, azimuth))
        is_hill = elevation < top
        image[is_hill], shown[is_hill] = color, HILLS
    below = np.broadcast_to(elevation < 0, shown.shape)
    image[below], shown[below] = PLAIN, GROUND
    mean = image.reshape(ROWS, FINER, 2 * ROWS, FINER, 3).mean(axis=(1, 3))
    return mean.astype(np.float32), shown[FINER // 2 :: FINER, FINER // 2 :: FINER]


def main(folder: Path) -> None:
    """Write the image and its label map."""
    folder.mkdir(parents=True, exist_ok=True)
    image, shown = sky_image(np.random.default_rng(8))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: image[..., i].astype(np.float16) for i, name in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(str(folder / "hills.exr"))
    colors = np.array(list(COLORS_OF_LABELS.values()), dtype=np.uint8)
    cv2.imwrite(str(folder / "hills_labels.png"), colors[shown][..., ::-1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    usual = Path(__file__).parent / "skies"
    parser.add_argument("folder", nargs="?", type=Path, default=usual, help="where to write")
    main(parser.parse_args().folder)
