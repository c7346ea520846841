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
    """Blender's images of texture sets, each converted on first use, and the removal of all images.

    Cycles knows an image by its address, until a render goes without it. One that Cycles may have
    is removed only then: a new one at its address would be shown with its pixels.
    """

    def __init__(self) -> None:
        super().__init__()
        self._images: dict[tuple[int, str], tuple[PbrMaps, Any]] = {}
        self._in_cycles: set[int] = set()

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

    def begin_render(self) -> None:
        """Take all images for those that Cycles has."""
        self._in_cycles = _addresses()

    def end_render(self) -> None:
        """Remove unused images, after renders that were not broken off.

        Those made since `begin_render` stay: one of several renders may have been the last to use
        them.
        """
        self._in_cycles = _addresses() - self._in_cycles
        self.remove_unused()
        self.begin_render()

    def forget_cycles(self) -> None:
        """Take it that Cycles has no image, as after its data was freed."""
        self._in_cycles.clear()

    def remove_unused(self) -> None:
        """Remove images that nothing uses any more, but for those that Cycles may have."""
        unused = [
            image
            for image in bpy.data.images
            if image.users <= image.use_fake_user
            and image.source != "VIEWER"
            and image.as_pointer() not in self._in_cycles
        ]
        if not unused:
            return
        kept = {key: held for key, held in self._images.items() if held[1] not in unused}
        self._images = kept
        bpy.data.batch_remove(unused)
        self.keep_levels({key for key, _ in kept})

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
            self._images[key] = (maps, image)
        return self._images[key][1]


def _addresses() -> set[int]:
    return {image.as_pointer() for image in bpy.data.images}


def purge_orphans() -> None:
    """Remove whatever nothing uses, but images: see `ImageStore`."""
    for image in bpy.data.images:
        if not image.use_fake_user:
            image.use_fake_user = True
    bpy.data.orphans_purge(do_recursive=True)


def new_image(name: str, pixels: NDArray[np.float32], *, is_float: bool, is_color: bool) -> Any:
    """Return an image of (rows, cols, 4) float32 pixels, bottom row first.

    `ImageStore.remove_unused` removes it once no material uses it any more.
    """
    rows, cols, _ = pixels.shape
    image = bpy.data.images.new(name, cols, rows, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(np.ascontiguousarray(pixels, dtype=np.float32).ravel())
    image.update()
    return image
