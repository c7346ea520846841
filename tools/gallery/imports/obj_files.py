"""An OBJ file with its MTL and pictures, y up as Blender exports it, made by code."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

TEXTURE_PX = 256
WIDE_M, DEEP_M, WALL_M, RIDGE_M, EAVES_M = 3.0, 2.2, 1.8, 2.7, 0.25

Corner = tuple[float, float, float]


def write_hut(folder: Path) -> Path:
    """Write ``hut.obj`` with ``hut.mtl`` and three pictures; return the OBJ file."""
    for name, picture in (("planks", planks()), ("shingles", shingles()), ("door", door())):
        picture.save(folder / f"hut_{name}.png")
    names = ("planks", "shingles", "door")
    materials = [f"newmtl {name}\nKd 1 1 1\nmap_Kd hut_{name}.png\n" for name in names]
    (folder / "hut.mtl").write_text("\n".join(materials))
    lines = ["mtllib hut.mtl", "o hut"]
    count = 0
    for name, corners in _faces():
        lines.append(f"usemtl {name}")
        for (x, y, z), (u, v) in zip(corners, _places(corners), strict=True):
            lines += [f"v {x:.4f} {y:.4f} {z:.4f}", f"vt {u:.4f} {v:.4f}"]
        numbers = range(count + 1, count + len(corners) + 1)
        lines.append("f " + " ".join(f"{number}/{number}" for number in numbers))
        count += len(corners)
    path = folder / "hut.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def _faces() -> list[tuple[str, list[Corner]]]:
    """Return material and corners of each face, counter-clockwise from outside, y up."""
    a, b, h, top = WIDE_M / 2, DEEP_M / 2, WALL_M, RIDGE_M
    slope = (top - h) / b
    out, low = b + EAVES_M, h - slope * EAVES_M
    side = a + EAVES_M
    return [
        ("planks", [(-a, 0, b), (a, 0, b), (a, h, b), (-a, h, b)]),
        ("planks", [(a, 0, -b), (-a, 0, -b), (-a, h, -b), (a, h, -b)]),
        ("planks", [(a, 0, b), (a, 0, -b), (a, h, -b), (a, top, 0), (a, h, b)]),
        ("planks", [(-a, 0, -b), (-a, 0, b), (-a, h, b), (-a, top, 0), (-a, h, -b)]),
        ("shingles", [(-side, low, out), (side, low, out), (side, top, 0), (-side, top, 0)]),
        ("shingles", [(side, low, -out), (-side, low, -out), (-side, top, 0), (side, top, 0)]),
        ("door", [(-0.4, 0, b + 0.02), (0.4, 0, b + 0.02), (0.4, 1.6, b + 0.02),
                  (-0.4, 1.6, b + 0.02)]),
    ]  # fmt: skip


def _places(corners: list[Corner]) -> list[tuple[float, float]]:
    """Return texture coordinates: metres along the face and up it; a door is one picture."""
    points = np.array(corners)
    along = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
    normal = np.cross(along, points[2] - points[1])
    across = np.cross(normal / np.linalg.norm(normal), along)
    places = np.stack(((points - points[0]) @ along, (points - points[0]) @ across), axis=1)
    if len(corners) == 4 and np.ptp(points[:, 0]) < 1.0 and np.ptp(points[:, 2]) == 0:
        places /= places.max(axis=0)
    return [(float(u), float(v)) for u, v in places]


def _image(rgb: tuple[int, int, int], shade: NDArray[np.float64]) -> Image.Image:
    pixels = np.clip(np.array(rgb) * shade[..., None], 0, 255)
    return Image.fromarray(pixels.astype(np.uint8))


def _grain(rng: np.random.Generator, axis: int) -> NDArray[np.float64]:
    noise = rng.normal(0, 0.05, (TEXTURE_PX, TEXTURE_PX))
    return np.asarray(np.cumsum(noise, axis=axis) * 4 / np.sqrt(TEXTURE_PX))


def planks() -> Image.Image:
    """Six upright planks of weathered wood on a metre."""
    rng = np.random.default_rng(21)
    x = np.arange(TEXTURE_PX) * 6 / TEXTURE_PX
    tone = rng.uniform(0.75, 1.1, 6)[x.astype(int)]
    gap = np.where((x % 1 < 0.05) | (x % 1 > 0.97), 0.35, 1.0)
    return _image((146, 112, 76), (tone * gap)[None, :] * (1 + _grain(rng, 0)))


def shingles() -> Image.Image:
    """Rows of dark shingles, eight on a metre, each row beginning half a shingle further."""
    rng = np.random.default_rng(22)
    y, x = np.mgrid[0:TEXTURE_PX, 0:TEXTURE_PX] * 8 / TEXTURE_PX
    row = y.astype(int)
    across = (x + 0.5 * (row % 2)) % 8
    tone = rng.uniform(0.6, 1.1, (8, 8))[row, across.astype(int)]
    edge = np.where((across % 1 < 0.07) | (y % 1 > 0.88), 0.45, 1.0)
    return _image((122, 62, 50), tone * edge * (0.8 + 0.25 * (y % 1)))


def door() -> Image.Image:
    """A green door with two panels and a handle."""
    y, x = np.mgrid[0:TEXTURE_PX, 0:TEXTURE_PX] / TEXTURE_PX
    inside = (np.abs(x - 0.5) < 0.32) & ((np.abs(y - 0.27) < 0.17) | (np.abs(y - 0.72) < 0.2))
    frame = (np.minimum(x, 1 - x) < 0.05) | (y < 0.03)
    image = np.asarray(_image((52, 96, 70), np.where(inside, 0.8, 1.0) * np.where(frame, 0.5, 1)))
    handle = (x - 0.88) ** 2 + (y - 0.52) ** 2 < 0.0009
    return Image.fromarray(np.where(handle[..., None], np.uint8(215), image))
