"""Materials of .obj files: the diffuse colour and the dissolve of .mtl files."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.errors import show_field
from oaisys_core.files.mesh_formats.mesh_texts import check_parts
from oaisys_core.procedural.meshes.cut_outs import cut_out
from oaisys_core.procedural.meshes.loaded import decode_texture, multiply_image
from oaisys_core.procedural.meshes.obj_format.mtl_statements import (
    MtlMaterial,
    MtlStatements,
    TextureMap,
)
from oaisys_core.procedural.meshes.references import MOST_NAMES, FileReferences
from oaisys_core.scene import MeshMaterial, Wrap
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

WHITE = (1.0, 1.0, 1.0)
PLAIN_SRGB = (0.8, 0.8, 0.8)
"""Colour of a material without ``Kd``, which is Blender's."""


class ObjMaterial(NamedTuple):
    """A material, and how its image lies on a mesh.

    Attributes:
        material: Its colours.
        plain: The same without images, for faces without texture coordinates.
        scale, offset: (2,) by which texture coordinates are multiplied, then moved.
    """

    material: MeshMaterial
    plain: MeshMaterial
    scale: FloatArray
    offset: FloatArray


class ObjMaterials:
    """The materials of a file."""

    def __init__(
        self, path: Path, references: FileReferences, libraries: Sequence[str], used: Sequence[str]
    ) -> None:
        """Read libraries, and warn of what is missing.

        Args:
            path: The .obj file.
            references: Opens files for it.
            libraries: What stands behind each ``mtllib``.
            used: Names of the materials that it uses.
        """
        self._path, self._references = path, references
        self._libraries: set[Path] = set()
        self._texts: dict[str, MtlMaterial] = {}
        self._found: dict[str, ObjMaterial] = {}
        self._images: dict[Path, Any] = {}
        for line in libraries:
            self._read_library(line)
        missing = [name for name in used if name not in self._texts]
        _tell(path, "no .mtl file has these materials, so they are grey", missing)

    def of(self, name: str | None) -> ObjMaterial | None:
        """Return the material of a name; None if no library has it."""
        if name not in self._texts or name is None:
            return None
        if name not in self._found:
            self._found[name] = self._make(name, self._texts[name])
        return self._found[name]

    def _read_library(self, line: str) -> None:
        """Read a library, or several whose names are divided by spaces."""
        names = re.split(r"[ \t]+", line)
        if len(names) > 1 and self._references.peek(line) is not None:
            names = [line]
        for name in names:
            place = self._references.place(name)
            content = None if place in self._libraries else self._references.find(name)
            self._libraries.add(place)
            check_parts(len(self._libraries), "material libraries: join them")
            if content is not None:
                found = MtlStatements(content, show_field(name))
                _tell(self._path, f"{found.file}: lines that are not read", list(found.unknown))
                twice = [*found.repeated, *(self._texts.keys() & found.materials.keys())]
                _tell(self._path, "materials that come again, of which the last counts", twice)
                self._texts |= found.materials

    def _make(self, name: str, said: MtlMaterial) -> ObjMaterial:
        where = f"{self._path}: material {name!r}"
        color_map, opacity_map = said.texture(b"map_kd"), said.texture(b"map_d")
        image = None if color_map is None else self._image(color_map.file)
        color = said.color() or (WHITE if image is not None else PLAIN_SRGB)
        if image is not None and not any(color):
            # Some exporters write black where the image is all there is.
            color = WHITE
        dissolve = said.dissolve()
        alpha = None if opacity_map is None else self._opacity(opacity_map)
        if alpha is None and image is not None and image[1] is not None and image[1].min() < 128:
            LOG.warning("%s: the alpha of its image is not used, as it has no map_d", where)
        opacity = cut_out(alpha, dissolve, 0.5, where, is_mask=False)
        placed = color_map or opacity_map
        self._tell_unread(where, color_map, opacity_map)
        material = MeshMaterial(
            name,
            color,
            None if image is None else multiply_image(image[0], linear(color)),
            opacity,
            min(127.5 / max(dissolve, 1e-9), 510.0),
            _wrap(placed),
        )
        scale = np.array((1.0, 1.0) if placed is None else placed.scale)
        offset = np.array((0.0, 0.0) if placed is None else placed.offset)
        return ObjMaterial(material, MeshMaterial(name, color), scale, offset)

    @staticmethod
    def _tell_unread(where: str, color: TextureMap | None, opacity: TextureMap | None) -> None:
        """Log what its maps say that would change what one sees, and is left out."""
        for each in (color, opacity):
            if each is not None and each.unread:
                LOG.warning("%s: %s is not read: %s", where, " and ".join(each.unread), each.where)
        if color is not None and opacity is not None and color.place != opacity.place:
            LOG.warning("%s: map_d lies as map_Kd does: %s", where, opacity.where)

    def _image(self, file: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None] | None:
        place = self._references.place(file)
        if place not in self._images:
            data = self._references.find(file)
            self._images[place] = None if data is None else decode_texture(data, file)
        found: tuple[NDArray[np.uint8], NDArray[np.uint8] | None] | None = self._images[place]
        return found

    def _opacity(self, texture: TextureMap) -> NDArray[np.uint8] | None:
        """Return the channel of an image that its map names.

        That is its alpha, or its brightness if it has no alpha, unless ``-imfchan`` says otherwise.
        """
        image = self._image(texture.file)
        if image is None:
            return None
        colors, alpha = image
        if texture.channel in ("r", "g", "b"):
            return np.ascontiguousarray(colors[..., "rgb".index(texture.channel)])
        if texture.channel == "m":
            return alpha
        if not texture.channel and alpha is not None and alpha.min() < alpha.max():
            return alpha
        return np.asarray(np.rint(colors.mean(axis=2)), np.uint8)


def _tell(path: Path, what: str, names: Sequence[str]) -> None:
    """Log names, if there are any, of which the first suffice."""
    if names:
        shown = ", ".join(map(show_field, names[:MOST_NAMES]))
        LOG.warning("%s: %s: %s", path, what, shown + (", …" if len(names) > MOST_NAMES else ""))


def _wrap(texture: TextureMap | None) -> tuple[Wrap, Wrap]:
    is_clamped = texture is not None and texture.is_clamped
    return ("clamp", "clamp") if is_clamped else ("repeat", "repeat")
