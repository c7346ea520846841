"""Blender images from numpy arrays, without files."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.shading.texture_levels import LevelStore
from oaisys_core.scene import PbrMaps

BYTE = np.float32(1 / 255)
"""Factor from bytes to the floats that Blender takes."""

OPAQUE = np.full((1, 1), 255, dtype=np.uint8)


class ImageStore(LevelStore):
    """Blender's images of texture sets; each map is converted on first use."""

    def __init__(self) -> None:
        super().__init__()
        self._images: dict[tuple[int, str], tuple[PbrMaps, Any]] = {}

    def color(self, maps: PbrMaps) -> Any:
        """Return the albedo with `heights` in alpha."""
        heights = self.heights(maps).texels
        return self._store(maps, "color", maps.color_srgb, heights, is_color=True)

    def normal_roughness(self, maps: PbrMaps) -> Any:
        """Return the normal with roughness in alpha, so that one lookup gives both."""
        return self._store(maps, "normal", maps.normal_gl, maps.roughness)

    def height(self, maps: PbrMaps) -> Any:
        """Return the height, 0 to 1."""
        return self._store(maps, "height", maps.height[..., None] * 255)

    def remove_unused(self) -> None:
        """Remove images that no material uses any more."""
        unused = [key for key, (_, image) in self._images.items() if image.users <= 1]
        bpy.data.batch_remove([self._images.pop(key)[1] for key in unused])
        self.keep_levels({key for key, _ in self._images})

    def _store(
        self,
        maps: PbrMaps,
        kind: str,
        rgb: NDArray[Any],
        alpha: NDArray[np.uint8] = OPAQUE,
        *,
        is_color: bool = False,
    ) -> Any:
        key = (id(maps), kind)
        if key not in self._images:
            pixels = np.empty((*rgb.shape[:2], 4), dtype=np.float32)
            np.multiply(rgb[::-1], BYTE, out=pixels[..., :3])
            np.multiply(alpha[::-1], BYTE, out=pixels[..., 3])
            image = new_image(f"{maps.name}_{kind}", pixels, is_float=False, is_color=is_color)
            # A user beside the materials, so that only `remove_unused` removes it.
            image.use_fake_user = True
            self._images[key] = (maps, image)
        return self._images[key][1]


def new_image(name: str, pixels: NDArray[np.float32], *, is_float: bool, is_color: bool) -> Any:
    """Return an image of (rows, cols, 4) float32 pixels, bottom row first."""
    rows, cols, _ = pixels.shape
    image = bpy.data.images.new(name, cols, rows, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(np.ascontiguousarray(pixels, dtype=np.float32).ravel())
    image.update()
    return image
