"""Reading a user's folder of PBR maps, named as by their libraries, see `map_names`."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.textures.fields import normals_from_height
from oaisys_core.procedural.textures.map_names import (
    COLOR,
    GLOSS,
    HEIGHT,
    NORMAL,
    OCCLUSION,
    PACKED,
    ROUGHNESS,
    WORDS,
    MapFile,
    maps_in,
)
from oaisys_core.procedural.textures.map_pixels import (
    Image,
    read_color,
    read_grey,
    read_height,
    read_normals,
    read_single,
)
from oaisys_core.procedural.textures.normal_maps import encode_normals
from oaisys_core.scene import PbrMaps

LOG = logging.getLogger(__name__)

COLOR_MAP_EXPECTED = (
    "a folder with a readable image with one of"
    f" {', '.join(WORDS[COLOR].replace('-', '_').split())} in its name, for the colour map"
)

FOLDER_RELIEF_M = 0.05
"""Height of the full range of a height map if normals must be derived from it."""
DEFAULT_ROUGHNESS = 0.9

CERTAIN = 0.3
"""Correlation of normals with slopes from which on they are of the same ground."""

OCCLUSION_SHARE = 0.6
"""Strength of the occlusion map: cracks receive less sky light, but still sunlight."""

Maps = dict[str, MapFile]


def texture_folders(path: Path) -> list[Path]:
    """Return the subfolders with a colour map, sorted by name.

    Raises:
        InvalidInputError: There are none.
    """
    folders = sorted(
        each for each in path.iterdir() if each.is_dir() and COLOR in maps_in(each).used
    )
    if not folders:
        raise InvalidInputError("folder", str(path), "a folder of folders with a colour map each")
    return folders


def has_color_map(path: Path) -> bool:
    """Return whether a path is a folder with a readable colour map."""
    import cv2

    found = maps_in(path).used.get(COLOR) if path.is_dir() else None
    if found is None:
        return False
    # OpenCV reads only the first bytes of the file.
    return found.path.suffix.lower() == ".exr" or cv2.haveImageReader(str(found.path))


def load_texture_folder(path: Path, tile_m: float, size_px: int | None = None) -> PbrMaps:
    """Return the maps in a folder; only the colour map is required.

    Missing normals are derived from the height map (flat without one); missing roughness is 0.9.
    DirectX normals are converted to OpenGL's convention, gloss to roughness. Occlusion darkens the
    colour.

    Args:
        path: The folder.
        tile_m: Edge length of a tile.
        size_px: Edge length to which maps are resized; None for that of the colour map.

    Raises:
        InvalidInputError: The folder, or a readable colour map in it, is missing.
    """
    if not path.is_dir():
        raise InvalidInputError("folder", str(path), "an existing folder of texture maps")
    files = maps_in(path).used
    if COLOR not in files:
        raise InvalidInputError("folder", str(path), COLOR_MAP_EXPECTED)
    color = read_color(files[COLOR].path)
    if color.shape[0] != color.shape[1]:
        rows, columns = color.shape[:2]
        LOG.warning("%s: %d x %d pixels become a square tile", files[COLOR].path, columns, rows)
    size = size_px or min(color.shape[:2])
    height = _height(files, size)
    roughness, occlusion = _roughness_and_occlusion(files, size)
    color = _resize(color, size) * (1 - OCCLUSION_SHARE * (1 - occlusion))[..., None]
    return PbrMaps(
        name=path.name,
        color_srgb=_bytes(color),
        height=np.zeros((size, size), np.float32) if height is None else height,
        normal_gl=_normals(files, size, height, tile_m),
        roughness=_bytes(roughness),
        tile_m=tile_m,
    )


def describe_texture_folder(path: Path) -> str:
    """Return which map of a folder is used for what, and what is left aside."""
    return f"{path}: {maps_in(path)}"


def _normals(files: Maps, size: int, height: Image | None, tile_m: float) -> NDArray[np.uint8]:
    if NORMAL not in files:
        flat = np.zeros((size, size), np.float32)
        return normals_from_height(flat if height is None else height, FOLDER_RELIEF_M, tile_m)
    normals = _resize(read_normals(files[NORMAL].path), size)
    if is_green_down(files[NORMAL], normals, height):
        normals = normals * np.array((1, -1, 1), np.float32)
    # Bytes of 127 and 128 are both flat: programs differ in which of them they write.
    return encode_normals(normals)


def is_green_down(file: MapFile, normals: Image, height: Image | None) -> bool:
    """Return whether normals are DirectX's: by the file's name, else by the height map beside it.

    Args:
        file: The normal map.
        normals: (S, S, 3) from -1 to 1, as the file has them.
        height: (S, S), if there is one.
    """
    leaning = 0.0 if height is None else _green_direction(normals, height)
    is_named_down = file.convention == "dx"
    if file.convention and leaning and (leaning < 0) != is_named_down:
        LOG.warning("%s: its name says %s, the heights do not", file.path, file.convention)
    if file.convention:
        return is_named_down
    name, reason = ("DirectX", "heights") if leaning < 0 else ("OpenGL", "heights")
    if not leaning:
        reason = "neither its name nor heights beside it say which (add _dx or _gl to the name)"
    LOG.warning("%s: taken for %s's normals, by: %s", file.path, name, reason)
    return leaning < 0


def _green_direction(normals: Image, height: Image) -> float:
    """Return 1 or -1 if normals lean along the slopes of heights, green up or down, else 0."""
    down, right = (np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (0, 1))
    along_x, along_y = _correlation(normals[..., 0], -right), _correlation(normals[..., 1], down)
    return float(np.sign(along_y)) if min(along_x, abs(along_y)) > CERTAIN else 0.0


def _correlation(one: Image, other: Image) -> float:
    spread = float(one.std() * other.std())
    return float(((one - one.mean()) * (other - other.mean())).mean()) / spread if spread else 0.0


def _height(files: Maps, size: int) -> Image | None:
    if HEIGHT in files:
        return _resize(read_height(files[HEIGHT].path), size)
    return _packed(files, HEIGHT, size)


def _roughness_and_occlusion(files: Maps, size: int) -> tuple[Image, Image]:
    roughness, occlusion = _single(files, ROUGHNESS, size), _single(files, OCCLUSION, size)
    if roughness is None and (gloss := _single(files, GLOSS, size)) is not None:
        roughness = 1 - gloss
    if roughness is None:
        roughness = np.full((size, size), DEFAULT_ROUGHNESS, np.float32)
    return roughness, np.ones((size, size), np.float32) if occlusion is None else occlusion


def _single(files: Maps, kind: str, size: int) -> Image | None:
    if kind in files:
        return _resize(read_single(files[kind].path), size)
    return _packed(files, kind, size)


def _packed(files: Maps, kind: str, size: int) -> Image | None:
    """Return the channel of a packed map that is of a kind; None if there is none."""
    if PACKED not in files or kind not in files[PACKED].channels:
        return None
    file = files[PACKED]
    return _resize(read_grey(file.path, file.channels.index(kind)), size)


def _resize(image: Image, size: int) -> Image:
    import cv2

    if image.shape[:2] == (size, size):
        return image
    shrinks = size < min(image.shape[:2])
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (size, size), interpolation=method), np.float32)


def _bytes(image: Image) -> NDArray[np.uint8]:
    return np.asarray(np.rint(image * 255), np.uint8)
