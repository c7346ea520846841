"""Makes the texture folders beside this file: `python make_textures.py [FOLDER]`.

Small on purpose: they show how folders are named and how a label image goes with its texture.
"""

# ruff: noqa: INP001 - a script, not a package

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oaisys_core.procedural.terrain.noise import Field, spectral
from oaisys_core.procedural.textures.fields import normals_from_height

SIZE = 128
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 82)


def grainy(
    rng: np.random.Generator, color: tuple[int, int, int], rough: float
) -> tuple[Field, Field]:
    """Return the colour (0 to 1) and the height of loose ground."""
    height = spectral(SIZE, 5, rng, rough)
    height = (height - height.min()) / np.ptp(height)
    shade = 0.75 + 0.4 * height + 0.05 * spectral(SIZE, 30, rng, 1.0)
    return np.clip(np.array(color) / 255 * shade[..., None], 0, 1), height


def slabs(rng: np.random.Generator) -> tuple[Field, Field, NDArray[np.bool_]]:
    """Return the colour and height of slabs in sand, and where slabs are."""
    points = rng.uniform(0, SIZE, (14, 2))
    places = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).reshape(-1, 2) + 0.5
    distance, cell = cKDTree(points, boxsize=SIZE).query(places, k=2)
    joint = (distance[:, 1] - distance[:, 0]).reshape(SIZE, SIZE)
    is_slab = joint > 5
    sand, grains = grainy(rng, (196, 168, 128), 1.4)
    stone, relief = grainy(rng, (138, 126, 116), 1.7)
    stone = stone * (0.8 + 0.4 * rng.random(len(points))[cell[:, 0]].reshape(SIZE, SIZE, 1))
    color = np.where(is_slab[..., None], np.clip(stone, 0, 1), sand)
    rise = np.clip((joint - 3) / 8, 0, 1)
    return color, 0.15 * grains + rise * (0.7 + 0.15 * relief), is_slab


def write(folder: Path, maps: dict[str, NDArray[np.uint8]]) -> None:
    """Write a folder of maps, colours given as RGB."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in maps.items():
        cv2.imwrite(str(folder / name), image[..., ::-1] if image.ndim == 3 else image, JPEG)


def small(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image of half the size."""
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def to_bytes(image: Field) -> NDArray[np.uint8]:
    """Return bytes of values from 0 to 1."""
    return np.asarray(np.rint(np.clip(image, 0, 1) * 255), np.uint8)


def main(folder: Path) -> None:
    """Write all texture folders into a folder."""
    rng = np.random.default_rng(7)
    color, height, is_slab = slabs(rng)
    normal = small(normals_from_height(height.astype(np.float32), 0.05, 2.0))
    original = {
        "slabs_COL.jpg": to_bytes(color),
        "slabs_NRM.jpg": normal,
        "slabs_DISP.jpg": small(to_bytes(height)),
        "slabs_GLOSS.jpg": small(to_bytes(0.05 + 0.2 * is_slab)),
    }
    write(folder / "slabs", original)
    write(folder, {"slabs_labels.png": (255 * is_slab).astype(np.uint8)})
    for name, tone in (("ochre_soil", (170, 118, 70)), ("slate_grit", (96, 98, 104))):
        color, height = grainy(rng, tone, 1.3)
        normal = normals_from_height(height.astype(np.float32), 0.06, 2.0)
        normal[..., 1] = 255 - normal[..., 1]
        arm = np.stack((0.6 + 0.4 * height, 0.9 + 0 * height, 0 * height), axis=-1)
        poly_haven = {
            f"{name}_diff_1k.jpg": to_bytes(color),
            f"{name}_nor_dx_1k.jpg": small(normal),
            f"{name}_arm_1k.jpg": small(to_bytes(arm)),
        }
        write(folder / "pool" / name, poly_haven)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    usual = Path(__file__).parent
    parser.add_argument("folder", nargs="?", type=Path, default=usual, help="where to write")
    main(parser.parse_args().folder)
