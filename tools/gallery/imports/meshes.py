"""Meshes as people bring them, made by code: a rover of five textured materials, a leafy plant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

TEXTURE_PX = 256
LEAVES, LEAF_M = 90, 0.34

Part = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]
"""(V, 3) vertices with y up, (T, 3) triangles, (V, 2) texture coordinates."""


def box(size_m: Sequence[float], at_m: Sequence[float]) -> Part:
    """Return a box, whose six faces each show the whole texture."""
    half = np.array(size_m) / 2
    vertices: list[NDArray[np.float64]] = []
    triangles, uv = [], []
    for axis in range(3):
        for sign in (-1, 1):
            along, across = (axis + 1) % 3, (axis + 2) % 3
            first = len(vertices)
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corner = np.zeros(3)
                corner[axis] = sign
                corner[along], corner[across] = sign * (2 * u - 1), 2 * v - 1
                vertices.append(corner * half + at_m)
                uv.append((u, v))
            triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return np.array(vertices), np.array(triangles), np.array(uv, np.float64)


def tube(radius_m: float, length_m: float, at_m: Sequence[float], axis: int, turns: int) -> Part:
    """Return a closed cylinder along an axis, around which the texture repeats ``turns`` times."""
    sides, rows = 24, (0.0, 0.0, 1.0, 1.0)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    circle = np.stack((np.zeros_like(angle), np.cos(angle), np.sin(angle)), axis=1)
    rings, uv = [], []
    for place, (end, radius) in enumerate(((-0.5, 0.0), (-0.5, 1.0), (0.5, 1.0), (0.5, 0.0))):
        ring = circle * radius * radius_m
        ring[:, 0] = end * length_m
        rings.append(np.roll(ring, axis, axis=1) + at_m)
        uv.append(np.stack((turns * angle / (2 * np.pi), np.full(sides + 1, rows[place])), axis=1))
    count = sides + 1
    triangles = []
    for ring_number in range(3):
        for side in range(sides):
            a = ring_number * count + side
            triangles += [(a, a + count + 1, a + 1), (a, a + count, a + count + 1)]
    return np.concatenate(rings), np.array(triangles), np.concatenate(uv)


def join(parts: Sequence[Part]) -> Part:
    """Return several parts as one."""
    starts = np.cumsum([0] + [len(part[0]) for part in parts[:-1]])
    return (
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=True)]),
        np.concatenate([part[2] for part in parts]),
    )


def foil() -> Image.Image:
    """Golden foil in creases."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[0:TEXTURE_PX, 0:TEXTURE_PX] / TEXTURE_PX
    points = rng.random((60, 2))
    distance = np.abs(
        np.stack([(x - px) * np.cos(9 * px) + (y - py) * np.sin(9 * px) for px, py in points])
    ).min(axis=0)
    shade = 0.55 + 0.45 * np.clip(distance * 40, 0, 1) + 0.1 * np.sin(23 * x + 31 * y)
    pixels = np.clip(shade[..., None] * np.array((236, 178, 62)), 0, 255)
    return Image.fromarray(pixels.astype(np.uint8))


def solar() -> Image.Image:
    """Dark blue cells between silver lines."""
    image = Image.new("RGB", (TEXTURE_PX, TEXTURE_PX), (18, 28, 74))
    draw = ImageDraw.Draw(image)
    for line in range(0, TEXTURE_PX, 32):
        draw.line((0, line, TEXTURE_PX, line), fill=(190, 195, 205), width=3)
        draw.line((line, 0, line, TEXTURE_PX), fill=(190, 195, 205), width=3)
    return image


def tread() -> Image.Image:
    """Grousers across a wheel."""
    image = Image.new("RGB", (64, 64), (88, 88, 92))
    ImageDraw.Draw(image).rectangle((0, 0, 22, 64), fill=(28, 28, 30))
    return image


def stripes() -> Image.Image:
    """Red and white rings around a mast."""
    image = Image.new("RGB", (32, TEXTURE_PX), (235, 235, 230))
    draw = ImageDraw.Draw(image)
    for top in range(0, TEXTURE_PX, 64):
        draw.rectangle((0, top, 32, top + 31), fill=(196, 32, 28))
    return image


def lens() -> Image.Image:
    """Two lenses in a grey housing."""
    image = Image.new("RGB", (128, 128), (150, 152, 158))
    draw = ImageDraw.Draw(image)
    for x in (34, 94):
        draw.ellipse((x - 24, 40, x + 24, 88), fill=(20, 20, 26))
        draw.ellipse((x - 9, 55, x + 9, 73), fill=(70, 90, 160))
    return image


def leaf() -> Image.Image:
    """A leaf with its midrib, transparent around it."""
    image = Image.new("RGBA", (128, 128), (40, 90, 30, 0))
    draw = ImageDraw.Draw(image)
    t = np.linspace(0, np.pi, 60)
    width = 34 * np.sin(t) ** 0.8 * (1 + 0.15 * np.cos(14 * t))
    y = 124 - 120 * t / np.pi
    outline = [*zip(64 + width, y, strict=True), *zip(64 - width[::-1], y[::-1], strict=True)]
    draw.polygon([(float(a), float(b)) for a, b in outline], fill=(64, 128, 44, 255))
    draw.line((64, 126, 64, 8), fill=(150, 190, 96, 255), width=4)
    for step in range(20, 110, 18):
        draw.line((64, step + 14, 90, step), fill=(110, 160, 70, 255), width=2)
        draw.line((64, step + 14, 38, step), fill=(110, 160, 70, 255), width=2)
    # What lies outside of the outline is transparent again.
    mask = Image.new("L", image.size, 0)
    ImageDraw.Draw(mask).polygon([(float(a), float(b)) for a, b in outline], fill=255)
    image.putalpha(mask)
    return image


def bark() -> Image.Image:
    """Brown bark in rows."""
    rows = np.random.default_rng(2).normal(0, 12, (64, 64)).cumsum(axis=0) / 4
    pixels = np.clip(np.array((104, 78, 52)) + rows[..., None], 0, 255)
    return Image.fromarray(pixels.astype(np.uint8))


def write_rover(path: Path) -> None:
    """Write a rover, 1.3 m high, y up, with five materials of one image each."""
    wheels = [tube(0.17, 0.16, (x, 0.17, z), 2, 8) for x in (-0.5, 0.0, 0.5) for z in (-0.42, 0.42)]
    parts: dict[str, tuple[Part, Callable[[], Image.Image]]] = {
        "body": (box((1.1, 0.3, 0.6), (0, 0.48, 0)), foil),
        "panel": (box((1.25, 0.03, 0.86), (-0.05, 0.66, 0)), solar),
        "wheels": (join(wheels), tread),
        "mast": (tube(0.04, 0.5, (0.45, 0.92, 0), 1, 1), stripes),
        "head": (box((0.14, 0.16, 0.34), (0.46, 1.22, 0)), lens),
    }
    scene = trimesh.Scene()
    for name, (part, image) in parts.items():
        scene.add_geometry(_mesh(part, name, image()), node_name=name, geom_name=name)
    scene.export(path)


def write_plant(path: Path) -> None:
    """Write a bush of leaf cards, about 1 m high, y up, whose alpha cuts the leaves out."""
    rng = np.random.default_rng(7)
    cards = []
    for number in range(LEAVES):
        height_m = 0.15 + 0.75 * number / LEAVES
        turn = 2.4 * number
        out = np.array((np.cos(turn), 0.45 + 0.5 * rng.random(), np.sin(turn)))
        out /= np.linalg.norm(out)
        side = np.cross(out, (0, 1, 0))
        side /= np.linalg.norm(side)
        root = np.array((0.02 * out[0], height_m, 0.02 * out[2])) + 0.2 * rng.random() * out
        size = LEAF_M * (1.1 - 0.5 * number / LEAVES)
        corners = [
            root + size * (u - 0.5) * side + size * v * out
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1))
        ]
        uv = np.array(((0, 0), (1, 0), (1, 1), (0, 1)), np.float64)
        cards.append((np.array(corners), np.array(((0, 1, 2), (0, 2, 3))), uv))
    scene = trimesh.Scene()
    leaves = _mesh(join(cards), "leaves", leaf(), alphaMode="MASK", alphaCutoff=0.5)
    scene.add_geometry(leaves, node_name="leaves", geom_name="leaves")
    stem = _mesh(tube(0.025, 0.9, (0, 0.45, 0), 1, 2), "stem", bark())
    scene.add_geometry(stem, node_name="stem", geom_name="stem")
    scene.export(path)


def _mesh(part: Part, name: str, image: Image.Image, **alpha: object) -> trimesh.Trimesh:
    vertices, triangles, uv = part
    material = PBRMaterial(
        name=name, baseColorTexture=image, metallicFactor=0.0, roughnessFactor=0.8, **alpha
    )
    visual = TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, triangles, visual=visual, process=False)
