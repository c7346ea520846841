"""A user's folder of PBR maps, named as Poly Haven (and the original simulator) name them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.exr import read_channels
from oaisys_core.scene import PbrMaps
from oaisys_core.textures.fields import normals_from_height

KEYWORDS = {
    "color": ("diffuse", "diff", "albedo", "basecolor", "base_color", "color", "col"),
    "height": ("displacement", "disp", "height"),
    "normal": ("nor_gl", "normal_gl", "normalgl", "nor", "normal", "nrm"),
    "roughness": ("roughness", "rough"),
}
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr"})
FOLDER_RELIEF_M = 0.05
"""Height of a folder's displacement map where a normal map must be derived from it."""
DEFAULT_ROUGHNESS = 0.9


def load_texture_folder(path: Path, tile_m: float, size_px: int | None = None) -> PbrMaps:
    """Return the maps in a folder; only the colour map must be there.

    Missing normals are derived from the height map (flat without one), missing roughness is 0.9.

    Args:
        path: The folder.
        tile_m: Edge length of one tile.
        size_px: Edge length that all maps are resized to; None: that of the colour map.

    Raises:
        InvalidInputError: The folder, or a readable colour map in it, is missing.
    """
    if not path.is_dir():
        raise InvalidInputError("folder", str(path), "an existing folder of texture maps")
    files = {kind: _find(path, words) for kind, words in KEYWORDS.items()}
    if files["color"] is None:
        words = ", ".join(KEYWORDS["color"])
        expected = f"an image with one of {words} in its name, for the colour map"
        raise InvalidInputError("folder", str(path), expected)
    color = _image(files["color"])
    size = size_px or min(color.shape[:2])
    height = _grey(files["height"], size)
    if files["normal"] is not None:
        normal = np.rint(_resized(_image(files["normal"]), size) * 255).astype(np.uint8)
    else:
        flat = np.zeros((size, size), np.float32)
        normal = normals_from_height(flat if height is None else height, FOLDER_RELIEF_M, tile_m)
    roughness = _grey(files["roughness"], size)
    if roughness is None:
        roughness = np.full((size, size), DEFAULT_ROUGHNESS, np.float32)
    return PbrMaps(
        name=path.name,
        color_srgb=np.rint(_resized(color, size) * 255).astype(np.uint8),
        height=np.zeros((size, size), np.float32) if height is None else height,
        normal_gl=normal,
        roughness=np.rint(roughness * 255).astype(np.uint8),
        tile_m=tile_m,
    )


def _find(path: Path, words: tuple[str, ...]) -> Path | None:
    """Return the folder's image whose name holds the earliest of ``words`` as one of its parts."""
    images = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    for word in words:
        for file in images:
            name = f"_{file.stem.lower()}_".replace("-", "_").replace(" ", "_")
            if f"_{word}_" in name:
                return file
    return None


def _image(path: Path) -> NDArray[np.float32]:
    """Return (H, W, 3) RGB, 0 to 1.

    Raises:
        InvalidInputError: It cannot be read.
    """
    image = _exr_image(path) if path.suffix.lower() == ".exr" else _integer_image(path)
    return np.clip(image, 0, 1).astype(np.float32)


def _exr_image(path: Path) -> NDArray[np.float32]:
    channels = read_channels(path)
    grey = next(iter(channels.values()))
    return np.stack([channels.get(name, grey) for name in "RGB"], axis=-1)


def _integer_image(path: Path) -> NDArray[np.float32]:
    image: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InvalidInputError("folder", str(path), "a readable image")
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    scale = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0
    rgb = image[..., 2::-1] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2)
    return np.asarray(rgb / np.float32(scale), np.float32)


def _grey(path: Path | None, size: int) -> NDArray[np.float32] | None:
    return None if path is None else _resized(_image(path), size)[..., 0]


def _resized(image: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    if image.shape[:2] == (size, size):
        return image
    shrinks = size < min(image.shape[:2])
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (size, size), interpolation=method), np.float32)
