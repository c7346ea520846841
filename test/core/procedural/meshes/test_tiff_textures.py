"""Textures of meshes in TIFF: what was written, in each format that refers to files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image

from oaisys_core.color import srgb
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.meshes.files import load_mesh

OBJ = """mtllib a.mtl
v 0 0 0\nv 2 0 0\nv 2 1 0\nvt 0 0\nvt 1 0\nvt 1 1
usemtl a\nf 1/1 2/2 3/3
"""
PLY = """ply\nformat ascii 1.0\ncomment TextureFile a.tif\nelement vertex 3
property float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t
element face 1\nproperty list uchar int vertex_indices\nend_header
0 0 0 0 0\n2 0 0 1 0\n2 1 0 1 1\n3 0 1 2
"""
GREY = np.arange(16).reshape(4, 4) / 15
COLORS = np.stack([GREY, GREY[::-1], GREY.T])


def mesh_file(folder: Path, kind: str) -> Path:
    (folder / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd a.tif\n")
    (folder / "a.obj").write_text(OBJ)
    (folder / "a.ply").write_text(PLY)
    return folder / f"a{kind}"


def write(folder: Path, shares: np.ndarray, dtype: str, **more: object) -> None:
    """Save (H, W) or (C, H, W) shares of white; of integers, of the largest."""
    planes = shares[None] if shares.ndim == 2 else shares
    bits = int(str(more.get("nbits", 8 * np.dtype(dtype).itemsize)))
    most = {"f": 1, "i": 2 ** (bits - 1) - 1, "u": 2**bits - 1}[np.dtype(dtype).kind]
    shape = dict(zip(("count", "height", "width"), planes.shape, strict=True))
    with rasterio.open(folder / "a.tif", "w", driver="GTiff", dtype=dtype, **shape, **more) as file:
        file.write((planes * most if most == 1 else np.rint(planes * most)).astype(dtype))


@pytest.mark.parametrize("kind", [".obj", ".ply"])
@pytest.mark.parametrize(
    ("dtype", "more"),
    [
        ("uint8", {}),
        ("uint16", {}),
        ("uint16", {"nbits": 12}),
        ("uint16", {"interleave": "band"}),
        ("float32", {}),
        ("float32", {"interleave": "band"}),
    ],
    ids=str,
)
def test_each_kind_of_values_is_read(
    tmp_path: Path, kind: str, dtype: str, more: dict[str, object]
) -> None:
    """Floats were black, 12 bits 16 times too dark, planes garbage."""
    shares = COLORS if "interleave" in more else GREY
    more = {"photometric": "RGB", **more} if "interleave" in more else more
    write(tmp_path, shares, dtype, **more)
    image = load_mesh(mesh_file(tmp_path, kind)).color_image_srgb
    assert image is not None
    expected = srgb(shares) if dtype == "float32" else shares  # floats are linear
    expected = np.broadcast_to(expected, (3, 4, 4))
    assert np.abs(np.moveaxis(image, -1, 0) / 255 - expected).max() <= 0.5 / 255 + 1e-4


@pytest.mark.parametrize("kind", [".obj", ".ply"])
@pytest.mark.parametrize("dtype", ["int8", "int16", "uint32", "float64"])
def test_values_of_other_types_are_refused_by_the_image(
    tmp_path: Path, kind: str, dtype: str
) -> None:
    write(tmp_path, np.ones((4, 4)), dtype)
    with pytest.raises(InvalidInputError, match=rf"a\.tif.*8 or 16 bits.*not {dtype}"):
        load_mesh(mesh_file(tmp_path, kind))


def test_a_transparent_image_keeps_colours_and_holes(tmp_path: Path) -> None:
    pixels = np.full((4, 4, 4), (10, 200, 30, 255), np.uint8)
    pixels[:2, :, 3] = 60
    Image.fromarray(pixels).save(tmp_path / "a.tif")
    path = mesh_file(tmp_path, ".obj")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.tif\nmap_d a.tif\n")
    material = load_mesh(path).materials[0]
    assert material.color_image_srgb is not None
    assert (material.color_image_srgb == (10, 200, 30)).all()
    assert material.opacity is not None
    assert (material.opacity[:2] == 60).all()
    assert (material.opacity[2:] == 255).all()
