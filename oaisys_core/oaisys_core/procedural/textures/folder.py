"""Reading a user's folder of PBR maps, named as by their libraries, see `map_names`."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import srgb
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.images import TEXTURE, read_pixels
from oaisys_core.output.exr import read_channels
from oaisys_core.procedural.textures.fields import normals_from_height
from oaisys_core.procedural.textures.map_names import (
    COLOR,
    GLOSS,
    HEIGHT,
    METALLIC_ROUGHNESS,
    NORMAL,
    OCCLUSION,
    PACKED,
    ROUGHNESS,
    WORDS,
    MapFile,
    maps_in,
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

GREY_STEP = 0.02
"""Difference of colours that is more than the noise of JPEG."""

OCCLUSION_SHARE = 0.6
"""Strength of the occlusion map: cracks receive less sky light, but still sunlight."""

Maps = dict[str, MapFile]
Image = NDArray[np.float32]


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
    color = _color(files[COLOR].path)
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
    if NORMAL in files:
        image = _resize(_image(files[NORMAL].path), size)
        if float(np.ptp(image, axis=-1).max()) < GREY_STEP:
            expected = "normals as red, green and blue; this is grey, perhaps a height map"
            raise InvalidInputError("folder", str(files[NORMAL].path), expected)
        if is_green_down(files[NORMAL], image, height):
            image = np.stack((image[..., 0], 1 - image[..., 1], image[..., 2]), axis=-1)
        # Bytes of 127 and 128 are both flat: programs differ in which of them they write.
        return encode_normals(2 * image - 1)
    flat = np.zeros((size, size), np.float32)
    return normals_from_height(flat if height is None else height, FOLDER_RELIEF_M, tile_m)


def is_green_down(file: MapFile, image: Image, height: Image | None) -> bool:
    """Return whether normals are DirectX's: by the file's name, else by the height map beside it.

    Args:
        file: The normal map.
        image: (S, S, 3), as the file has it.
        height: (S, S), if there is one.
    """
    leaning = 0.0 if height is None else _green_direction(image, height)
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


def _green_direction(image: Image, height: Image) -> float:
    """Return 1 or -1 if normals lean along the slopes of heights, green up or down, else 0."""
    down, right = (np.roll(height, -1, axis) - np.roll(height, 1, axis) for axis in (0, 1))
    along_x, along_y = _correlation(image[..., 0], -right), _correlation(image[..., 1], down)
    return float(np.sign(along_y)) if min(along_x, abs(along_y)) > CERTAIN else 0.0


def _correlation(one: Image, other: Image) -> float:
    spread = float(one.std() * other.std())
    return float(((one - one.mean()) * (other - other.mean())).mean()) / spread if spread else 0.0


def _roughness_and_occlusion(files: Maps, size: int) -> tuple[Image, Image]:
    roughness, occlusion = _grey(files, ROUGHNESS, size), _grey(files, OCCLUSION, size)
    if roughness is None and (gloss := _grey(files, GLOSS, size)) is not None:
        roughness = 1 - gloss
    if PACKED in files:
        packed = _resize(_image(files[PACKED].path), size)
        roughness = packed[..., 1] if roughness is None else roughness
        occlusion = packed[..., 0] if occlusion is None else occlusion
    if METALLIC_ROUGHNESS in files and roughness is None:
        roughness = _resize(_image(files[METALLIC_ROUGHNESS].path), size)[..., 1]
    if roughness is None:
        roughness = np.full((size, size), DEFAULT_ROUGHNESS, np.float32)
    return roughness, np.ones((size, size), np.float32) if occlusion is None else occlusion


def _color(path: Path) -> Image:
    """Return (H, W, 3) sRGB-encoded colour; EXR images contain linear colour."""
    image = _image(path)
    if path.suffix.lower() != ".exr":
        return image
    return srgb(image)


def _height(files: Maps, size: int) -> Image | None:
    """Return heights from 0 to 1; those beyond, as in metres, are scaled to that range."""
    if HEIGHT not in files:
        return None
    path = files[HEIGHT].path
    height = _values(path)[..., 0]
    least, most = float(height.min()), float(height.max())
    if least < 0 or most > 1:
        LOG.warning("%s: heights from %.4g to %.4g are scaled to 0 to 1", path, least, most)
        height = (height - least) / (most - least if most > least else 1)
    return _resize(np.asarray(height, np.float32), size)


def _image(path: Path) -> Image:
    """Return an image as (H, W, 3) RGB, 0 to 1.

    Raises:
        InvalidInputError: It cannot be read.
    """
    return np.clip(_values(path), 0, 1).astype(np.float32)


def _values(path: Path) -> Image:
    values = _exr_image(path) if path.suffix.lower() == ".exr" else _integer_image(path)
    if not np.isfinite(values).all():
        raise InvalidInputError("folder", str(path), "an image of finite values")
    return values


def _exr_image(path: Path) -> NDArray[np.float32]:
    channels = read_channels(path, TEXTURE)
    grey = next(iter(channels.values()))
    return np.stack([channels.get(name, grey) for name in "RGB"], axis=-1)


def _integer_image(path: Path) -> NDArray[np.float32]:
    image = read_pixels(path, TEXTURE)
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    scale = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    rgb = image[..., 2::-1] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)
    return np.asarray(rgb / np.float32(scale), np.float32)


def _grey(files: Maps, kind: str, size: int) -> Image | None:
    return _resize(_image(files[kind].path), size)[..., 0] if kind in files else None


def _resize(image: Image, size: int) -> Image:
    import cv2

    if image.shape[:2] == (size, size):
        return image
    shrinks = size < min(image.shape[:2])
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (size, size), interpolation=method), np.float32)


def _bytes(image: Image) -> NDArray[np.uint8]:
    return np.asarray(np.rint(image * 255), np.uint8)
