"""Open Image Denoise, called in the library that comes with Blender.

Cycles calls the same library, but within its last light sample, whose time then says nothing, and
it gives guides the same denoising as the picture.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Mapping
from ctypes import CDLL, POINTER, byref, c_bool, c_char_p, c_int, c_size_t, c_void_p
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.backend.blender.time_budget import DenoisingQuality
from oaisys_core.errors import RenderError

Image = NDArray[np.float32]

LIBRARY = "libOpenImageDenoise.so.2"
"""By this name alone it is the one that is loaded already, with Blender."""

CPU_DEVICE, FLOAT3 = 1, 3
QUALITY_FAST, QUALITY_BALANCED = 4, 5
"""Values of ``OIDNDeviceType``, ``OIDNFormat`` and ``OIDNQuality``."""

OUTPUT = b"output"
"""Name of a filter's result."""

MOST_KEPT_PIXELS = 1920 * 1080
"""Of pictures whose filters are kept for the next one: the memory grows with the picture."""

_SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "oidnNewDevice": (c_void_p, [c_int]),
    "oidnSetDeviceBool": (None, [c_void_p, c_char_p, c_bool]),
    "oidnCommitDevice": (None, [c_void_p]),
    "oidnGetDeviceError": (c_int, [c_void_p, POINTER(c_char_p)]),
    "oidnNewFilter": (c_void_p, [c_void_p, c_char_p]),
    "oidnSetSharedFilterImage": (
        None,
        [c_void_p, c_char_p, c_void_p, c_int, *[c_size_t] * 5],
    ),
    "oidnSetFilterBool": (None, [c_void_p, c_char_p, c_bool]),
    "oidnSetFilterInt": (None, [c_void_p, c_char_p, c_int]),
    "oidnCommitFilter": (None, [c_void_p]),
    "oidnExecuteFilter": (None, [c_void_p]),
    "oidnReleaseFilter": (None, [c_void_p]),
}


class Denoiser:
    """Takes noise out of pictures, on the processor."""

    def __init__(self, library: CDLL) -> None:
        self._library = library
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._device = library.oidnNewDevice(CPU_DEVICE)
        # Else it binds this process's threads to cores, and Cycles' are among them.
        library.oidnSetDeviceBool(self._device, b"setAffinity", False)
        library.oidnCommitDevice(self._device)
        self._check()
        self._size = (0, 0)
        self._filters: dict[tuple[Any, ...], _Filter] = {}

    def denoise(
        self, color: Image, albedo: Image, normal: Image, denoising: DenoisingQuality
    ) -> Image:
        """Return a picture without its noise.

        Args:
            color: (H, W, 3) or (H, W, 4) radiance, of which the first three channels count.
            albedo, normal: (H, W, 3), as noisy as they come with it.
            denoising: ``fast`` takes a smaller network than ``balanced``, in half the time;
                ``thorough`` takes noise out of the guides first, and lets the picture follow them.

        Raises:
            RenderError: The library failed.
            ValueError: A guide is of another size.
        """
        for name, image in (("albedo", albedo), ("normal", normal)):
            if image.shape != (*color.shape[:2], 3):
                raise ValueError(f"{name}: received {image.shape} beside color {color.shape}")
        images = {b"color": color, b"albedo": albedo, b"normal": normal}
        thorough = denoising == "thorough"
        if thorough:
            for guide in (b"albedo", b"normal"):
                images[guide] = self._filtered({guide: images[guide]}, QUALITY_FAST)
        # The highest quality is worth a tenth of a decibel more, and half a second.
        quality = QUALITY_FAST if denoising == "fast" else QUALITY_BALANCED
        return self._filtered(images, quality, hdr=True, cleanAux=thorough)

    def _filtered(self, images: dict[bytes, Image], quality: int, **flags: bool) -> Image:
        height, width, _ = next(iter(images.values())).shape
        size = height, width
        if size != self._size:
            self._filters, self._size = {}, size
        wanted = (tuple(images), quality, *flags.items())
        made = self._filters.get(wanted)
        if made is None:
            made = _Filter(self._library, self._device, (*images, OUTPUT), size, quality, flags)
            self._check()
            if height * width <= MOST_KEPT_PIXELS:
                self._filters[wanted] = made
        result = made.run(images)
        self._check()
        return result

    def _check(self) -> None:
        message = c_char_p()
        if self._library.oidnGetDeviceError(self._device, byref(message)):
            text = (message.value or b"no reason given").decode(errors="replace")
            raise RenderError(f"Open Image Denoise failed: {text}")


class _Filter:
    """One of the library's filters with its images.

    It keeps the memory that it works in: to have 100 to 180 MB cleared for each picture of 640x480
    takes the system a fifth as long as the denoising itself.
    """

    def __init__(
        self,
        library: CDLL,
        device: Any,
        names: Iterable[bytes],
        size: tuple[int, int],
        quality: int,
        flags: Mapping[str, bool],
    ) -> None:
        """Set one up for images of (H, W) ``size``, the last one its result."""
        self._library = library
        self._handle = handle = library.oidnNewFilter(device, b"RT")
        weakref.finalize(self, library.oidnReleaseFilter, handle).atexit = False
        height, width = size
        self._images = {name: np.empty((height, width, 3), np.float32) for name in names}
        for name, image in self._images.items():
            library.oidnSetSharedFilterImage(
                handle, name, image.ctypes.data, FLOAT3, width, height, 0, 0, 0
            )
        for flag, value in flags.items():
            library.oidnSetFilterBool(handle, flag.encode(), value)
        library.oidnSetFilterInt(handle, b"quality", quality)
        library.oidnCommitFilter(handle)

    def run(self, images: Mapping[bytes, Image]) -> Image:
        """Return the result of images with three channels or more."""
        for name, image in images.items():
            self._images[name][...] = image[..., :3]
        self._library.oidnExecuteFilter(self._handle)
        return self._images[OUTPUT].copy()


@cache
def blenders_denoiser() -> Denoiser | None:
    """Return the denoiser of the library that Blender has loaded; None where it has another."""
    try:
        return Denoiser(CDLL(LIBRARY))
    except OSError:
        return None


CYCLES_WIDTH_PX = 1.5
"""Of the filter that noisy pictures go through, as Blender counts and by its default: the
Blackman-Harris window is twice as wide."""

SAMPLED_WIDTH_PX = 0.75
"""Of the filter that samples of denoised pictures are taken by."""

MANY_SHARE = 0.065
"""Part of its light that a pixel gives to each neighbour where samples are many: with it, the two
steps filter as widely as Cycles alone does at its own width."""

FEW_SHARE, FEW_SAMPLES = 0.095, 8
"""Part that it gives up to so many samples: the best one, against pictures of 512."""

GUIDE_SHARE = 0.06
"""Part of what guides the denoiser. It is worth a tenth of a decibel, and more does harm."""


def filter_denoised(light: NDArray[np.float32], samples: int) -> NDArray[np.float32]:
    """Return a picture in which neighbours share their light.

    Args:
        light: (H, W, 3) radiance, without noise.
        samples: Per pixel, that it was made of.
    """
    few = min(1.0, FEW_SAMPLES / max(samples, 1))
    return _mixed(light, MANY_SHARE + (FEW_SHARE - MANY_SHARE) * few)


def filter_guide(guide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W, 3) albedo or normals of few samples, as neighbours share them."""
    return _mixed(guide, GUIDE_SHARE)


def _mixed(image: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    kernel = np.array([share, 1 - 2 * share, share], np.float32)
    whole = np.ascontiguousarray(image)
    filtered = cv2.sepFilter2D(whole, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, dtype=np.float32)
