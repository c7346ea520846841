"""Materials of .obj files: the diffuse colour and the dissolve of .mtl files."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.meshes.cut_outs import cut_out
from oaisys_core.procedural.meshes.loaded import decode_texture, multiply_image
from oaisys_core.procedural.meshes.references import FileReferences
from oaisys_core.scene import MeshMaterial, Wrap
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

WHITE = (1.0, 1.0, 1.0)
PLAIN_SRGB = (0.8, 0.8, 0.8)
"""Colour of a material without ``Kd``, which is Blender's."""

OPTIONS = {"-o": 3, "-s": 3, "-t": 3, "-mm": 2}
"""Options of maps with so many numbers at most; all others have one value."""


class ObjMaterial(NamedTuple):
    """A material, and how its image lies on a mesh.

    Attributes:
        material: Its colours.
        scale, offset: (2,) by which texture coordinates are multiplied, then moved.
    """

    material: MeshMaterial
    scale: FloatArray
    offset: FloatArray


class TextureMap(NamedTuple):
    """A map of a .mtl file: its file, and its options."""

    file: str
    options: Mapping[str, Sequence[str]]

    def numbers(self, option: str, default: float) -> FloatArray:
        """Return the (2,) first numbers of an option."""
        given = [float(value) for value in self.options.get(option, ())[:2]]
        return np.array([*given, default, default][:2])


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
        self._texts: dict[str, dict[str, str]] = {}
        self._found: dict[str, ObjMaterial] = {}
        self._images: dict[str, Any] = {}
        for line in libraries:
            self._read_library(line)
        missing = [name for name in used if name not in self._texts]
        if missing:
            names = ", ".join(missing[:5]) + (", …" if len(missing) > 5 else "")
            LOG.warning("%s: no .mtl file has these materials, so they are grey: %s", path, names)

    def of(self, name: str | None) -> ObjMaterial | None:
        """Return the material of a name; None if no library has it."""
        if name not in self._texts or name is None:
            return None
        if name not in self._found:
            self._found[name] = self._make(name, self._texts[name])
        return self._found[name]

    def _read_library(self, line: str) -> None:
        """Read a library, or several whose names are divided by spaces."""
        data = None if " " not in line else self._references.peek(line)
        names = [line] if data is not None or " " not in line else line.split()
        for name in names:
            content = self._references.find(name)
            if content is not None:
                self._texts |= _materials(content.decode("utf-8", errors="replace"))

    def _make(self, name: str, keys: Mapping[str, str]) -> ObjMaterial:
        where = f"{self._path}: material {name!r}"
        color_map = _map(keys.get("map_kd"))
        image = None if color_map is None else self._image(color_map.file)
        color = _color(keys.get("kd"), WHITE if image is not None else PLAIN_SRGB)
        if image is not None and not any(color):
            # Some exporters write black where the image is all there is.
            color = WHITE
        dissolve = _number(keys.get("d"), 1.0 - _number(keys.get("tr"), 0.0))
        opacity_map = _map(keys.get("map_d"))
        alpha = None if opacity_map is None else self._opacity(opacity_map.file)
        if alpha is None and image is not None and image[1] is not None and image[1].min() < 128:
            LOG.warning("%s: the alpha of its image is not used, as it has no map_d", where)
        opacity = cut_out(alpha, dissolve, 0.5, where, is_mask=False)
        material = MeshMaterial(
            name,
            color,
            None if image is None else multiply_image(image[0], linear(color)),
            opacity,
            min(127.5 / max(dissolve, 1e-9), 510.0),
            _wrap(color_map or opacity_map),
        )
        placed = color_map or opacity_map or TextureMap("", {})
        return ObjMaterial(material, placed.numbers("-s", 1.0), placed.numbers("-o", 0.0))

    def _image(self, file: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None] | None:
        if file not in self._images:
            data = self._references.find(file)
            self._images[file] = None if data is None else decode_texture(data, file)
        found: tuple[NDArray[np.uint8], NDArray[np.uint8] | None] | None = self._images[file]
        return found

    def _opacity(self, file: str) -> NDArray[np.uint8] | None:
        """Return the alpha of an image, or its brightness if it has no alpha."""
        image = self._image(file)
        if image is None:
            return None
        colors, alpha = image
        if alpha is not None and alpha.min() < alpha.max():
            return alpha
        return np.asarray(np.rint(colors.mean(axis=2)), np.uint8)


def _materials(text: str) -> dict[str, dict[str, str]]:
    """Return the lines of each material of a .mtl file, by lower-case keyword."""
    found: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.strip().partition(" ")
        key, value = key.split("\t")[0].lower(), value.strip() or line.strip().partition("\t")[2]
        if key == "newmtl":
            current = found.setdefault(value, {})
        elif key and not key.startswith("#"):
            current[key] = value
    return found


def _map(value: str | None) -> TextureMap | None:
    """Return a map's file, whose name may contain spaces, and the options before it."""
    if not value:
        return None
    words, options = value.split(), {}
    while words and words[0].startswith("-") and len(words) > 1:
        option = words.pop(0)
        count = 0
        while count < OPTIONS.get(option, 1) and count < len(words) - 1:
            if count and not _is_number(words[count]):
                break
            count += 1
        options[option] = words[:count]
        words = words[count:]
    # The rest as it stands, with its own spaces.
    start = value.rfind(words[0]) if len(words) == 1 else value.find(" ".join(words))
    return TextureMap(value[start:].strip() if start >= 0 else " ".join(words), options)


def _wrap(texture: TextureMap | None) -> tuple[Wrap, Wrap]:
    is_clamped = texture is not None and list(texture.options.get("-clamp", ())) == ["on"]
    return ("clamp", "clamp") if is_clamped else ("repeat", "repeat")


def _color(value: str | None, default: tuple[float, float, float]) -> tuple[float, float, float]:
    words = (value or "").split()
    if not words or not all(map(_is_number, words[:3])):
        return default
    numbers = [min(max(float(word), 0.0), 1.0) for word in words[:3]]
    red, green, blue = numbers if len(numbers) == 3 else numbers[:1] * 3
    return (red, green, blue)


def _number(value: str | None, default: float) -> float:
    words = [word for word in (value or "").split() if word != "-halo"]
    if not words or not _is_number(words[0]):
        return default
    return min(max(float(words[0]), 0.0), 1.0)


def _is_number(word: str) -> bool:
    try:
        return bool(np.isfinite(float(word)))
    except ValueError:
        return False
