"""Meshes as they are in their files, and the merging of their parts."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb, linear
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import (
    is_png,
    is_tiff,
    png_transparent,
    tiff_header,
)
from oaisys_core.files.image_formats.image_use import MESH_TEXTURE
from oaisys_core.files.image_formats.images import decode_pixels
from oaisys_core.procedural.meshes.checks import NOT_COARSE, Float32Step, are_used
from oaisys_core.scene import MeshMaterial
from oaisys_core.types import FloatArray, ShortRepr

OPAQUE, HALF = 255, 127.5
"""Opacity of a surface without holes, and the least one of a surface."""

MAX_MATERIALS = 65_536
"""Materials of a mesh, as each triangle has the number of one in 16 bits."""

GREY = 128
"""Byte of a part without any colour beside parts that have one."""


@dataclass(frozen=True, repr=False)
class LoadedMesh(ShortRepr):
    """A mesh as it is in its file.

    Attributes:
        name: Name of the object, or of the file.
        vertices_m: (V, 3), z up, in the units of the file: float32, or float64 where the file has
            digits or a pose. Whoever knows the scale takes a local origin before float32, see
            `oaisys_core.procedural.meshes.checks.local_origin`.
        triangles: (T, 3) int32.
        uv: (T, 3, 2) float32 texture coordinates of the corners, v up; None without an image.
        vertex_colors_srgb: (V, 3) uint8; None without vertex colours.
        materials: Whose colours count times those of the vertices; none: these alone.
        material_of: (T,) uint16 index into ``materials`` of each triangle; None: the first.
        float32: How fine the file's numbers are, where it has float32.
    """

    name: str
    vertices_m: NDArray[Any]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None = None
    vertex_colors_srgb: NDArray[np.uint8] | None = None
    materials: tuple[MeshMaterial, ...] = ()
    material_of: NDArray[np.uint16] | None = None
    float32: Float32Step = NOT_COARSE

    @property
    def color_image_srgb(self) -> NDArray[np.uint8] | None:
        """(H, W, 3) uint8 image of the first material, row 0 at the top; None without one."""
        return self.materials[0].color_image_srgb if self.materials else None


def merge_parts(name: str, parts: Sequence[LoadedMesh], field: str = "mesh") -> LoadedMesh:
    """Return several meshes as one of the given name; each part keeps its materials.

    Raises:
        InvalidInputError: They have more than `MAX_MATERIALS`; the error has ``field``.
    """
    if len(parts) == 1:
        return replace(parts[0], name=name)
    starts = np.cumsum([0] + [len(part.vertices_m) for part in parts[:-1]])
    merged = LoadedMesh(
        name=name,
        vertices_m=np.concatenate([part.vertices_m for part in parts]),
        triangles=np.concatenate(
            [p.triangles + np.int32(start) for p, start in zip(parts, starts, strict=True)]
        ),
        float32=max((part.float32 for part in parts), key=lambda float32: float32.step),
    )
    if not any(part.materials for part in parts):
        return replace(merged, vertex_colors_srgb=_colors(parts, GREY))
    materials, material_of = _materials(parts)
    if len(materials) > MAX_MATERIALS:
        expected = f"a mesh of at most {MAX_MATERIALS} materials, not {len(materials)}"
        raise InvalidInputError(field, name, expected)
    known = any(part.uv is not None for part in parts)
    return replace(
        merged,
        uv=np.concatenate([_uv(part) for part in parts]) if known else None,
        vertex_colors_srgb=_colors(parts, 255),
        materials=materials,
        material_of=material_of.astype(np.uint16),
    )


def _uv(part: LoadedMesh) -> NDArray[np.float32]:
    return np.zeros((len(part.triangles), 3, 2), np.float32) if part.uv is None else part.uv


def _colors(parts: Sequence[LoadedMesh], missing: int) -> NDArray[np.uint8] | None:
    """Return the colours of all vertices; None if no part has any."""
    if all(part.vertex_colors_srgb is None for part in parts):
        return None
    found = []
    for part in parts:
        # Without a material, what has no colour of its own is grey; with one, it counts alone.
        fill = GREY if not part.materials else missing
        plain = np.full((len(part.vertices_m), 3), fill, np.uint8)
        found.append(plain if part.vertex_colors_srgb is None else part.vertex_colors_srgb)
    return np.concatenate(found)


def _materials(parts: Sequence[LoadedMesh]) -> tuple[tuple[MeshMaterial, ...], NDArray[np.int64]]:
    materials: list[MeshMaterial] = []
    places: dict[int, int] = {}
    of_parts = []
    for part in parts:
        own = part.materials or (plain_material(part),)
        index = []
        for material in own:
            if id(material) not in places:
                places[id(material)] = len(materials)
                materials.append(material)
            index.append(places[id(material)])
        which = part.material_of
        which = np.zeros(len(part.triangles), np.uint16) if which is None else which
        of_parts.append(np.array(index)[which])
    return tuple(materials), np.concatenate(of_parts)


def plain_material(part: LoadedMesh) -> MeshMaterial:
    """Return the material of a part that has none: grey, or white under vertex colours."""
    if part.vertex_colors_srgb is None:
        return MeshMaterial(part.name, color_srgb=(0.5, 0.5, 0.5))
    return MeshMaterial(part.name)


def without_unused(mesh: LoadedMesh) -> LoadedMesh:
    """Return a mesh without vertices that no triangle has: they would count in its extent."""
    used = are_used(mesh.vertices_m, mesh.triangles)
    if used.all():
        return mesh
    colors = mesh.vertex_colors_srgb
    return replace(
        mesh,
        vertices_m=mesh.vertices_m[used],
        triangles=(np.cumsum(used, dtype=np.int32) - 1)[mesh.triangles],
        vertex_colors_srgb=None if colors is None else colors[used],
    )


def decode_texture(data: bytes, name: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Return the (H, W, 3) colours and the (H, W) alpha, if any, of a checked image's file.

    TIFF images and PNGs with a transparent colour are read as those of the ground are; floats are
    linear.

    Raises:
        InvalidInputError: It cannot be decoded; the error has its name.
    """
    from PIL import Image

    try:
        if is_tiff(data):
            return _split_pixels(data, name, has_alpha=tiff_header(data).has_alpha)
        if is_png(data) and png_transparent(data) is not None:
            # Pillow compares a key of 16 or fewer than 8 bits with values of 8.
            return _split_pixels(data, name, has_alpha=True)
        with Image.open(io.BytesIO(data)) as image:
            return split_image(image)
    except (OSError, ValueError, SyntaxError) as error:
        raise MESH_TEXTURE.refusal(name, error) from error


def _split_pixels(
    data: bytes, name: str, *, has_alpha: bool
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    pixels = decode_pixels(data, MESH_TEXTURE, name)
    if not np.isfinite(pixels).all():
        raise InvalidInputError(MESH_TEXTURE.field, name, "a mesh's texture of finite numbers")
    is_float = pixels.dtype.kind == "f"
    if not is_float:
        pixels = pixels / np.float32(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    shares = np.clip(pixels, 0, 1)
    colors = shares[..., 2::-1]
    colors = encode_srgb(colors) if is_float else np.rint(255 * colors).astype(np.uint8)
    alpha = np.rint(255 * shares[..., 3]).astype(np.uint8) if has_alpha else None
    return np.ascontiguousarray(colors), alpha


def split_image(image: Any) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Return colours and alpha of an image of Pillow likewise."""
    if image.mode.startswith(("I", "F")):
        grey = np.asarray(image, np.float64)
        grey = np.clip(grey / 257 if image.mode.startswith("I") else grey, 0, 255)
        return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2), None
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        pixels = np.array(image.convert("RGBA"), np.uint8)
        return np.ascontiguousarray(pixels[..., :3]), np.ascontiguousarray(pixels[..., 3])
    return np.array(image.convert("RGB"), np.uint8), None


def multiply_image(image_srgb: NDArray[np.uint8], factor: FloatArray) -> NDArray[np.uint8]:
    """Return an image in sRGB whose linear values are multiplied by (3,) linear factors."""
    if np.all(factor == 1):
        return image_srgb
    levels = linear(np.arange(256) / 255)
    table = np.stack([encode_srgb(levels * each) for each in factor], axis=1)
    return np.stack([table[image_srgb[..., c], c] for c in range(3)], axis=-1)
